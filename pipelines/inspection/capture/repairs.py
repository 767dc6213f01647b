"""Explanations of a wrong calibration: those that make the epipolar errors vanish."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.epipolar import MatchedPair, tolerances
from ggvs_eval.pipelines.inspection.capture.calibration_errors import FRONT_SHARE, camera_error, pair_error

FOCAL_FACTORS = np.linspace(0.85, 1.15, 31)
FINE_STEPS = np.linspace(-0.01, 0.01, 9)
# An explanation must leave at most this share of the error, else it merely bends with it.
REMAINING_SHARE = 0.5
# A fault that all share is half absorbed by the others' same fault, so it is looked for below the tolerance too.
LEAST_SHARE_OF_TOLERANCE = 0.25
# Plenty to tell a fault that all share, and one that a single camera has.
MOST_PAIRS, MOST_OWN_PAIRS = 80, 10
Change = Callable[[Camera], Camera]


@dataclass(frozen=True)
class Repair:
    """An explanation of a camera's errors.

    Attributes:
        kind: ``swap``, ``focal`` or ``pose``.
        meaning: what seems to be wrong and what to do.
        error_px: epipolar error that is left with it.
        other: index of the camera whose pose fits, for a swap.
        focal_factor: what to multiply the focal length by, for a focal length.
    """

    kind: str
    meaning: str
    error_px: float
    other: int | None = None
    focal_factor: float | None = None


def explain_camera(cameras: Sequence[Camera], pairs: Sequence[MatchedPair], index: int, trusted: Sequence[int]) -> Repair | None:
    """The explanation that suits one camera best, evaluated against trusted cameras; None where none does."""
    own = [pair for pair in pairs if index in (pair.first, pair.second) and pair.seen_from(index)[0] in trusted]
    own = sorted(own, key=lambda pair: -len(pair.uv_first))[:MOST_OWN_PAIRS]
    before = camera_error(cameras, own, index)
    if len(own) < 2:  # one pair constrains a pose too little
        return None
    candidates = [
        *_other_poses(cameras, own, index),
        *_turned_poses(cameras, own, index),
        _best_focal([index], cameras, own, lambda changed: camera_error(changed, own, index)),
    ]
    return _accepted(candidates, before, tolerances(cameras[index])[0])


def explain_rig(cameras: Sequence[Camera], pairs: Sequence[MatchedPair]) -> Repair | None:
    """One explanation for all cameras together; None where most agree already, or where none suits."""
    looked_at = pairs[:: len(pairs) // MOST_PAIRS + 1]

    def rig_error(changed: Sequence[Camera]) -> float:
        errors = [pair_error(changed, pair) for pair in looked_at]
        return float(np.median([error.median_px if error.front_share >= FRONT_SHARE else np.inf for error in errors]))

    before = rig_error(cameras) if pairs else 0.0
    if before < LEAST_SHARE_OF_TOLERANCE * min(tolerances(camera)[0] for camera in cameras):
        return None
    candidates = [
        Repair("pose", f"all cameras fit {name}", rig_error([change(camera) for camera in cameras]))
        for name, change in POSE_CHANGES.items()
    ]
    candidates.append(_best_focal(range(len(cameras)), cameras, pairs, rig_error))
    return _accepted(candidates, before, max(tolerances(camera)[0] for camera in cameras))


def with_focal(camera: Camera, factor: float) -> Camera:
    """The camera with its focal lengths multiplied."""
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= factor
    return replace(camera, K=K)


def _accepted(candidates: Sequence[Repair], before: float, tolerance_px: float) -> Repair | None:
    best = min(candidates, key=lambda repair: repair.error_px, default=None)
    if best is None or not best.error_px < min(tolerance_px, REMAINING_SHARE * before):
        return None
    return best


def _other_poses(cameras: Sequence[Camera], own: Sequence[MatchedPair], index: int) -> Iterator[Repair]:
    """The pose of each other camera in place of this one's."""
    for other, camera in enumerate(cameras):
        kept = [pair for pair in own if pair.seen_from(index)[0] != other]
        if other != index and len(kept) >= 2:
            moved = replace(cameras[index], world_to_camera=camera.world_to_camera)
            meaning = f"its images fit the pose of {camera.name}"
            yield Repair("swap", meaning, camera_error(_exchanged(cameras, index, moved), kept, index), other=other)


def _turned_poses(cameras: Sequence[Camera], own: Sequence[MatchedPair], index: int) -> Iterator[Repair]:
    for name, change in POSE_CHANGES.items():
        error_px = camera_error(_exchanged(cameras, index, change(cameras[index])), own, index)
        yield Repair("pose", f"its images fit {name}", error_px)


def _best_focal(
    which: Sequence[int], cameras: Sequence[Camera], pairs: Sequence[MatchedPair], measure: Callable[[list[Camera]], float]
) -> Repair:
    """The focal factor, common to some cameras, with the least error; searched coarsely, then finely."""

    def error_px(factor: float) -> float:
        return measure([with_focal(camera, factor) if place in which else camera for place, camera in enumerate(cameras)])

    coarse = min(FOCAL_FACTORS, key=error_px)
    factor = float(min(coarse + FINE_STEPS, key=error_px))
    length = cameras[which[0]].focal_px
    meaning = f"a focal length of {factor * length:.1f} px instead of {length:.1f} (x {factor:.3f}) fits the matches"
    return Repair("focal", meaning, error_px(factor), focal_factor=round(factor, 4))


def _exchanged(cameras: Sequence[Camera], index: int, camera: Camera) -> list[Camera]:
    return [camera if place == index else given for place, given in enumerate(cameras)]


def _turned(*signs: float) -> Change:
    """Half a turn about one of the camera's own axes."""
    turn = np.diag([*signs, 1.0])
    return lambda camera: replace(camera, world_to_camera=turn @ camera.world_to_camera)


def _reflected_centre(*signs: float) -> Change:
    """The centre reflected in the planes whose sign is -1, the rotation kept."""

    def change(camera: Camera) -> Camera:
        world_to_camera = camera.world_to_camera.copy()
        world_to_camera[:3, 3] = -camera.rotation @ (np.array(signs) * camera.centre)
        return replace(camera, world_to_camera=world_to_camera)

    return change


def _reflected_world(*signs: float) -> Change:
    """Pose mirrored in a world plane; the camera's axes along the mirrored image axis follow, so that it stays a rotation."""
    mirror = np.diag(signs)

    def change(camera: Camera) -> Camera:
        rotation = np.diag([-1.0, 1.0, 1.0]) @ camera.rotation @ mirror
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = rotation
        world_to_camera[:3, 3] = -rotation @ (mirror @ camera.centre)
        return replace(camera, world_to_camera=world_to_camera)

    return change


def _inverted(camera: Camera) -> Camera:
    return replace(camera, world_to_camera=np.asarray(np.linalg.inv(camera.world_to_camera), np.float64))


def _transposed(camera: Camera) -> Camera:
    world_to_camera = camera.world_to_camera.copy()
    world_to_camera[:3, :3] = camera.rotation.T
    world_to_camera[:3, 3] = -camera.rotation.T @ camera.centre
    return replace(camera, world_to_camera=world_to_camera)


POSE_CHANGES: dict[str, Change] = {
    "a pose turned by 180 degrees about its x axis (OpenGL axes taken for OpenCV's?)": _turned(1.0, -1.0, -1.0),
    "a pose turned by 180 degrees about its y axis": _turned(-1.0, 1.0, -1.0),
    "a pose turned by 180 degrees about its z axis (picture upside down?)": _turned(-1.0, -1.0, 1.0),
    "a centre mirrored in x": _reflected_centre(-1.0, 1.0, 1.0),
    "a centre mirrored in y": _reflected_centre(1.0, -1.0, 1.0),
    "a centre mirrored in z": _reflected_centre(1.0, 1.0, -1.0),
    "a centre mirrored in the origin (sign of the translation?)": _reflected_centre(-1.0, -1.0, -1.0),
    "a pose mirrored in x": _reflected_world(-1.0, 1.0, 1.0),
    "a pose mirrored in y": _reflected_world(1.0, -1.0, 1.0),
    "a pose mirrored in z": _reflected_world(1.0, 1.0, -1.0),
    "the inverse pose (camera-to-world taken for world-to-camera?)": _inverted,
    "the transposed rotation": _transposed,
}
