"""Epipolar error: cameras whose calibration contradicts their images, and the likely reason.

An explanation of a wrong calibration is one that makes the epipolar errors vanish.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.finding import RIG, SEVERITY, Finding, Verdict, graded
from ggvs_eval.geometry.epipolar import Features, MatchedPair, neighbour_pairs, tolerances
from ggvs_eval.pipelines.inspection.capture.pairs import (
    FRONT_SHARE,
    SIGMAS,
    PairError,
    accused,
    camera_error,
    has_parallax,
    is_wrong,
    match_pairs,
    pair_error,
)

FOCAL_FACTORS = np.linspace(0.85, 1.15, 31)
FINE_STEPS = np.linspace(-0.01, 0.01, 9)
# An explanation must leave at most this share of the error, else it merely bends with it.
REMAINING_SHARE = 0.5
# A fault that all share is half absorbed by the others' same fault, so it is looked for below the
# tolerance too.
LEAST_SHARE_OF_TOLERANCE = 0.25
# Enough to distinguish a fault that all share from that of a single camera.
MOST_PAIRS, MOST_OWN_PAIRS = 80, 10
Change = Callable[[Camera], Camera]
QUESTION = "epipolar error"
# Bounds for sequences that give each of hundreds of pictures a separate camera.
MOST_JUDGES, MOST_EXPLAINED = 24, 8
GROSS_FOCAL = 0.03
REFINE = "refine the poses (run with --calibration refined)"
RECALIBRATE = f"{REFINE}, or drop this camera"


@dataclass(frozen=True)
class Repair:
    """An explanation of a camera's errors.

    Attributes:
        kind: ``swap``, ``focal`` or ``pose``.
        meaning: what seems to be wrong and what to do.
        error_px: epipolar error that is left with it.
        donor: index of the camera whose pose fits, for a swap.
        focal_factor: what to multiply the focal length by, for a focal length.
    """

    kind: str
    meaning: str
    error_px: float
    donor: int | None = None
    focal_factor: float | None = None


def explain_camera(
    cameras: Sequence[Camera], pairs: Sequence[MatchedPair], index: int, trusted: Sequence[int]
) -> Repair | None:
    """Return the explanation that suits one camera best, evaluated against trusted cameras.

    None if none does.
    """
    own_pairs = [
        pair
        for pair in pairs
        if index in (pair.first, pair.second) and pair.seen_from(index)[0] in trusted
    ]
    own_pairs = sorted(own_pairs, key=lambda pair: -len(pair.uv_first))[:MOST_OWN_PAIRS]
    before = camera_error(cameras, own_pairs, index)
    if len(own_pairs) < 2:  # one pair constrains a pose too little
        return None
    candidates = [
        *_other_poses(cameras, own_pairs, index),
        *(
            Repair(
                "pose",
                f"its images fit {name}",
                camera_error(_exchanged(cameras, index, change(cameras[index])), own_pairs, index),
            )
            for name, change in POSE_CHANGES.items()
        ),
        _best_focal(
            [index], cameras, own_pairs, lambda changed: camera_error(changed, own_pairs, index)
        ),
    ]
    return _accepted(candidates, before, tolerances(cameras[index])[0])


def explain_rig(
    cameras: Sequence[Camera], pairs: Sequence[MatchedPair], exchange: bool = False
) -> Repair | None:
    """Return one explanation for all cameras together.

    None where most agree already, or where none suits.

    Args:
        exchange: try that two have exchanged their frames, too: in a small rig none agrees with
            most others then.
    """
    looked_at = pairs[:: len(pairs) // MOST_PAIRS + 1]

    def rig_error(changed: Sequence[Camera]) -> float:
        errors = [pair_error(changed, pair) for pair in looked_at]
        return float(
            np.median(
                [
                    error.median_px if error.front_share >= FRONT_SHARE else np.inf
                    for error in errors
                ]
            )
        )

    before = rig_error(cameras) if pairs else 0.0
    if before < LEAST_SHARE_OF_TOLERANCE * min(tolerances(camera)[0] for camera in cameras):
        return None
    candidates = [
        Repair("pose", f"all cameras fit {name}", rig_error([change(camera) for camera in cameras]))
        for name, change in POSE_CHANGES.items()
    ]
    candidates.append(_best_focal(range(len(cameras)), cameras, pairs, rig_error))
    for one, two in combinations(cameras if exchange and len(cameras) <= MOST_JUDGES else (), 2):
        places = {one.name: two, two.name: one}
        moved = [replace(places.get(camera.name, camera), name=camera.name) for camera in cameras]
        candidates.append(
            Repair(
                "swap",
                f"they fit if {one.name} and {two.name} exchange frames or poses",
                rig_error(moved),
            )
        )
    return _accepted(candidates, before, max(tolerances(camera)[0] for camera in cameras))


def with_focal(camera: Camera, factor: float) -> Camera:
    """Return the camera with its focal lengths multiplied."""
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= factor
    return replace(camera, K=K)


def _accepted(candidates: Sequence[Repair], before: float, tolerance_px: float) -> Repair | None:
    best = min(candidates, key=lambda repair: repair.error_px, default=None)
    if best is None or not best.error_px < min(tolerance_px, REMAINING_SHARE * before):
        return None
    return best


def _other_poses(
    cameras: Sequence[Camera], own_pairs: Sequence[MatchedPair], index: int
) -> Iterator[Repair]:
    """Yield the pose of each other camera in place of this one's."""
    for donor, camera in enumerate(cameras):
        pairs_left = [pair for pair in own_pairs if pair.seen_from(index)[0] != donor]
        if donor != index and len(pairs_left) >= 2:
            moved = replace(cameras[index], world_to_camera=camera.world_to_camera)
            meaning = f"its images fit the pose of {camera.name}"
            yield Repair(
                "swap",
                meaning,
                camera_error(_exchanged(cameras, index, moved), pairs_left, index),
                donor=donor,
            )


def _best_focal(
    indices: Sequence[int],
    cameras: Sequence[Camera],
    pairs: Sequence[MatchedPair],
    measure: Callable[[list[Camera]], float],
) -> Repair:
    """Return the focal factor, common to some cameras, with the least error.

    Searched coarsely, then finely.
    """

    def error_px(factor: float) -> float:
        return measure(
            [
                with_focal(camera, factor) if place in indices else camera
                for place, camera in enumerate(cameras)
            ]
        )

    coarse = min(FOCAL_FACTORS, key=error_px)
    factor = float(min(coarse + FINE_STEPS, key=error_px))
    length = cameras[indices[0]].focal_px
    meaning = (
        f"a focal length of {factor * length:.1f} px instead of {length:.1f} (x "
        f"{factor:.3f}) fits the matches"
    )
    return Repair("focal", meaning, error_px(factor), focal_factor=round(factor, 4))


def _exchanged(cameras: Sequence[Camera], index: int, camera: Camera) -> list[Camera]:
    return [camera if place == index else original for place, original in enumerate(cameras)]


def _turned(*signs: float) -> Change:
    """Return half a turn about one of the camera's own axes."""
    turn = np.diag([*signs, 1.0])
    return lambda camera: replace(camera, world_to_camera=turn @ camera.world_to_camera)


def _reflected_centre(*signs: float) -> Change:
    """Return the centre reflected in the planes whose sign is -1, the rotation kept."""
    return lambda camera: _posed(camera, camera.rotation, np.array(signs) * camera.centre)


def _reflected_world(axis: int, reversed_axis: int = 0) -> Change:
    """Pose mirrored along a world axis.

    One of the camera's own axes is reversed too, so that it stays a rotation.
    """
    mirror, reversed_ = (
        np.diag(np.where(np.arange(3) == number, -1.0, 1.0)) for number in (axis, reversed_axis)
    )
    return lambda camera: _posed(
        camera, reversed_ @ camera.rotation @ mirror, mirror @ camera.centre
    )


def _posed(camera: Camera, rotation: Array, centre: Array) -> Camera:
    """Return the camera with another rotation of the world's axes to its own, and another
    centre.
    """
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation
    world_to_camera[:3, 3] = -rotation @ centre
    return replace(camera, world_to_camera=world_to_camera)


POSE_CHANGES: dict[str, Change] = {
    "a pose turned by 180 degrees about its x axis (OpenGL axes used as OpenCV's?)": _turned(
        1.0, -1.0, -1.0
    ),
    "a pose turned by 180 degrees about its y axis": _turned(-1.0, 1.0, -1.0),
    "a pose turned by 180 degrees about its z axis (picture upside down?)": _turned(
        -1.0, -1.0, 1.0
    ),
    **{
        f"a centre mirrored in {word}": _reflected_centre(*signs)
        for word, signs in zip("xyz", 1 - 2 * np.eye(3), strict=True)
    },
    "a centre mirrored in the origin (sign of the translation?)": _reflected_centre(
        -1.0, -1.0, -1.0
    ),
    **{f"a pose mirrored in {word}": _reflected_world(axis) for axis, word in enumerate("xyz")},
    **{
        f"a pose mirrored in {word}, its own {letter} axis too (left-handed axes used as "
        f"right-handed?)": _reflected_world(axis, place)
        for letter, place in (("y", 1), ("z", 2))
        for axis, word in enumerate("xyz")
    },
    "the inverse pose (camera-to-world used as world-to-camera?)": lambda camera: replace(
        camera, world_to_camera=np.asarray(np.linalg.inv(camera.world_to_camera), np.float64)
    ),
    "the transposed rotation": lambda camera: _posed(camera, camera.rotation.T, camera.centre),
}


@dataclass(frozen=True)
class CalibrationVerdict:
    """Verdict of the matches on the calibration.

    Attributes:
        findings: for the rig and each camera.
        pairs: matched pairs, with those that were added for cameras in doubt.
        trusted: indices of cameras that agree with their neighbours; empty if they cannot be
            distinguished from the others.
        suspects: indices of cameras that do not.
    """

    findings: tuple[Finding, ...]
    pairs: tuple[MatchedPair, ...]
    trusted: tuple[int, ...]
    suspects: tuple[int, ...]


@dataclass(frozen=True)
class ClipVerdict:
    """Verdict on the calibration at several instants.

    Attributes:
        findings: for the rig and each camera, of the instant where it is worst.
        at: verdict of each instant, by frame, the first one first.
        trusted: cameras that agree with their neighbours at every instant at which any does.
        suspects: cameras that do not at any; one that was moved in mid-clip is none.
    """

    findings: tuple[Finding, ...]
    at: Mapping[int, CalibrationVerdict]
    trusted: tuple[int, ...]
    suspects: tuple[int, ...]

    @property
    def pairs(self) -> tuple[MatchedPair, ...]:
        """Matched pairs of all instants."""
        return tuple(pair for verdict in self.at.values() for pair in verdict.pairs)


def check_clip(
    cameras: Sequence[Camera], instants: Mapping[int, Sequence[Features | None]]
) -> ClipVerdict:
    """Evaluate the calibration at each instant.

    Args:
        instants: frame -> features of each camera; None of one without a picture.
    """
    pairs, at = neighbour_pairs(cameras), {}
    for frame, features in instants.items():
        at[frame] = check_epipolar(cameras, features, match_pairs(cameras, features, pairs))
    answers = {
        frame: verdict for frame, verdict in at.items() if verdict.findings[0].verdict != "unknown"
    } or at
    findings = tuple(
        _worst_instant(dict(zip(at, group, strict=True)))
        for group in zip(*(v.findings for v in at.values()), strict=True)
    )
    trusted = [
        index
        for index in range(len(cameras))
        if all(index in verdict.trusted for verdict in answers.values())
    ]
    suspects = [
        index
        for index in range(len(cameras))
        if all(index in verdict.suspects for verdict in answers.values())
    ]
    return ClipVerdict(findings=findings, at=at, trusted=tuple(trusted), suspects=tuple(suspects))


def _worst_instant(findings: Mapping[int, Finding]) -> Finding:
    """Return the answer of the instant at which it is worst.

    Of the first one that has an answer where all are alike.
    """
    answers = {
        frame: finding for frame, finding in findings.items() if finding.verdict != "unknown"
    } or dict(findings)
    worst = max(answers, key=lambda frame: SEVERITY[answers[frame].verdict])
    first = next(iter(answers))
    if worst == first:
        return answers[first]
    text = f"{answers[worst].measured} at frame {worst}; {answers[first].measured} at frame {first}"
    return replace(answers[worst], measured=text, values={**answers[worst].values, "frame": worst})


def check_epipolar(
    cameras: Sequence[Camera], features: Sequence[Features | None], pairs: Sequence[MatchedPair]
) -> CalibrationVerdict:
    """Evaluate every camera by the matches with its neighbours.

    A camera is accused when most of its pairs are wrong while the neighbours' other pairs are
    right; then what could be the reason is tried out on its matches with all trusted cameras.
    """
    all_pairs = tuple(pairs)
    pairs = [pair for pair in pairs if has_parallax(cameras[pair.first], cameras[pair.second])]
    errors = [pair_error(cameras, pair) for pair in pairs]
    suspects = accused(cameras, errors)
    matched = {index for pair in pairs for index in (pair.first, pair.second)}
    trusted = [index for index in sorted(matched) if index not in suspects]
    shared = explain_rig(cameras, pairs)
    over = [
        index
        for index in matched
        if camera_error(cameras, pairs, index, SIGMAS) > tolerances(cameras[index])[0]
    ]
    if shared or len(trusted) < max(2, len(matched) / 2) or len(over) > len(matched) / 2:
        shared = shared or explain_rig(cameras, pairs, exchange=True)
        return replace(_doubtful_rig(cameras, pairs, errors, shared), pairs=all_pairs)
    # Suspects are compared with trusted cameras all over the rig: of two exchanged ones each sees
    # what the other's neighbours do.
    matched_pairs = {(pair.first, pair.second) for pair in pairs}
    evaluates, tried = trusted[:: len(trusted) // MOST_JUDGES + 1], suspects[:MOST_EXPLAINED]
    missing_pairs = {
        (min(index, judge), max(index, judge)) for index in tried for judge in evaluates
    } - matched_pairs
    added = match_pairs(cameras, features, sorted(missing_pairs))
    pairs = [
        *pairs,
        *(pair for pair in added if has_parallax(cameras[pair.first], cameras[pair.second])),
    ]
    repairs = dict.fromkeys(suspects) | {
        index: explain_camera(cameras, pairs, index, trusted) for index in tried
    }
    evaluated = [
        _evaluate(cameras, features, pairs, index, trusted, repairs)
        for index in range(len(cameras))
    ]
    rig = _rig_finding(cameras, errors, suspects)
    return CalibrationVerdict(
        findings=(rig, *evaluated),
        pairs=(*all_pairs, *added),
        trusted=tuple(trusted),
        suspects=tuple(suspects),
    )


def _evaluate(
    cameras: Sequence[Camera],
    features: Sequence[Features | None],
    pairs: Sequence[MatchedPair],
    index: int,
    trusted: Sequence[int],
    repairs: dict[int, Repair | None],
) -> Finding:
    """Return one camera against the trusted ones."""
    name = cameras[index].name
    own_pairs = [
        pair
        for pair in pairs
        if index in (pair.first, pair.second) and pair.seen_from(index)[0] in trusted
    ]
    if not own_pairs:
        reason = (
            "no readable frame" if features[index] is None else "too few matches with any neighbour"
        )
        return Finding(
            subject=name,
            question=QUESTION,
            verdict="unknown",
            measured=reason,
            values={},
            advice="inspect this camera's picture and pose",
        )
    error_px = camera_error(cameras, own_pairs, index)
    values: dict[str, Any] = {
        "error_px": _finite(error_px),
        "n_pairs": len(own_pairs),
        "n_matches": sum(len(pair.uv_first) for pair in own_pairs),
    }
    error_text = f"{error_px:.2f} px" if np.isfinite(error_px) else "matches are behind the camera"
    repair, verdict = (
        repairs.get(index),
        graded(camera_error(cameras, own_pairs, index, SIGMAS), *tolerances(cameras[index])),
    )
    if index not in repairs:
        return Finding(
            subject=name,
            question=QUESTION,
            verdict=verdict,
            measured=error_text,
            values=values,
            advice="" if verdict == "ok" else RECALIBRATE,
        )
    text = f"{error_text} with {len(own_pairs)} cameras that agree among themselves"
    if repair is None:
        return Finding(
            subject=name,
            question=QUESTION,
            verdict=verdict,
            measured=text,
            values=values,
            advice=RECALIBRATE,
        )
    values |= {
        "repair": repair.kind,
        "error_after_px": round(repair.error_px, 3),
        "focal_factor": repair.focal_factor,
    }
    if repair.donor is not None:
        values["fits_pose_of"] = cameras[repair.donor].name
    text = f"{error_text}; {repair.meaning}: {repair.error_px:.2f} px"
    return Finding(
        subject=name,
        question=QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=_advice(cameras, index, repair, repairs),
    )


def _advice(
    cameras: Sequence[Camera], index: int, repair: Repair, repairs: dict[int, Repair | None]
) -> str:
    if repair.donor is not None:
        back = repairs.get(repair.donor)
        name = cameras[repair.donor].name
        if back is not None and back.donor == index:
            return f"exchange the frames of {cameras[index].name} and {name}, or their poses"
        return f"give it the pose of {name}"
    if repair.focal_factor is not None:
        return f"multiply its focal length by {repair.focal_factor:.3f}, or calibrate again"
    return "correct the pose as named, or calibrate again"


def _rig_finding(
    cameras: Sequence[Camera], errors: Sequence[PairError], suspects: Sequence[int]
) -> Finding:
    """Return all pairs of cameras that are not accused."""
    sound = [
        error for error in errors if error.first not in suspects and error.second not in suspects
    ]
    medians = [error.median_px for error in sound]
    odd = [
        f"{cameras[error.first].name} - {cameras[error.second].name}"
        for error in sound
        if is_wrong(cameras, error)
    ]
    values = {
        "median_px": _finite(float(np.median(medians))),
        "n_pairs": len(sound),
        "odd_pairs": odd,
    }
    text = (
        f"median {np.median(medians):.2f} px over {len(sound)} pairs, "
        f"{sum(error.n_matches for error in sound)} matches"
    )
    return Finding(
        subject=RIG,
        question=QUESTION,
        verdict="ok",
        measured=text + (f"; odd: {', '.join(odd[:4])}" if odd else ""),
        values=values,
    )


def _doubtful_rig(
    cameras: Sequence[Camera],
    pairs: Sequence[MatchedPair],
    errors: Sequence[PairError],
    repair: Repair | None,
) -> CalibrationVerdict:
    """No camera can be trusted more than the others: too few matches anywhere, or a fault that all
    share.
    """
    if not errors:
        reason = "too few matches between neighbours (far apart, dark or bare of texture)"
        unknown = [
            Finding(subject=camera.name, question=QUESTION, verdict="unknown", measured=reason)
            for camera in cameras
        ]
        rig = Finding(
            subject=RIG,
            question=QUESTION,
            verdict="unknown",
            measured=reason,
            values={},
            advice="compare pictures and poses manually",
        )
        return CalibrationVerdict(
            findings=(rig, *unknown), pairs=tuple(pairs), trusted=(), suspects=()
        )
    errors_px = [camera_error(cameras, pairs, index) for index in range(len(cameras))]
    certain = [camera_error(cameras, pairs, index, SIGMAS) for index in range(len(cameras))]
    verdicts = [
        graded(error, *tolerances(camera)) for error, camera in zip(certain, cameras, strict=True)
    ]
    # Half of the pairs of a rig hardly notice a common focal length, so their medians understate
    # it.
    is_gross = repair is not None and (
        repair.focal_factor is None or abs(repair.focal_factor - 1) > GROSS_FOCAL
    )
    verdict: Verdict = "bad" if is_gross or "bad" in verdicts else "warn"
    median_px = float(np.median([error.median_px for error in errors]))
    values: dict[str, Any] = {"median_px": _finite(median_px), "n_pairs": len(errors)}
    text = f"median {median_px:.1f} px over {len(errors)} pairs"
    if repair is None:
        text, advice = (
            f"{text}; no camera agrees with most others",
            f"{REFINE}; else check that poses and frames match, or calibrate without poses",
        )
    else:
        text, advice = (
            f"{text}; {repair.meaning}: {repair.error_px:.2f} px",
            "correct all cameras as named",
        )
        values |= {"repair": repair.kind, "focal_factor": repair.focal_factor}
    reason = "no neighbour is reliable"
    unknown = [
        Finding(
            subject=camera.name,
            question=QUESTION,
            verdict="unknown",
            measured=reason,
            values={"error_px": _finite(error)},
        )
        for camera, error in zip(cameras, errors_px, strict=True)
    ]
    suspects = tuple(range(len(cameras))) if verdict == "bad" else ()
    return CalibrationVerdict(
        findings=(
            Finding(
                subject=RIG,
                question=QUESTION,
                verdict=verdict,
                measured=text,
                values=values,
                advice=advice,
            ),
            *unknown,
        ),
        pairs=tuple(pairs),
        trusted=(),
        suspects=suspects,
    )


def _finite(value: float) -> float | None:
    """Return a number for JSON, which knows neither NaN nor infinity."""
    return round(value, 4) if np.isfinite(value) else None
