"""Near and far of a capture's cameras: given by a file, by the layout, measured on the pictures, or
guessed.

A guess is made from where the rig looks, or from a cloud of points.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, RangeOrigin
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.units import GUESSED, guess_units_per_metre, nearest_to_rays
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.names import listed
from ggvs_eval.files.plain import check_plain
from ggvs_eval.files.toml_tables import build_table, read_toml
from ggvs_eval.geometry.epipolar import (
    Features,
    find_features,
    match_pair,
    neighbour_pairs,
    remoteness,
    sound_matches,
)
from ggvs_eval.geometry.rectification import can_rectify

DEPTH_RANGE_FILE = "depth_range.toml"
RANGE_MEND = (
    f"{DEPTH_RANGE_FILE} with near and far in the capture's folder sets it; 'ggvs-eval "
    f"calibrate --known-poses' measures it"
)
# The scene is assumed to be between these multiples of the distance to the point that the rig looks
# at.
NEAR_FACTOR, FAR_FACTOR = 0.25, 4.0
# A rig that looks at no common point sees the scene from these many times the spacing of its
# cameras on.
NEAR_SPACINGS, FAR_SPACINGS = 5.0, 500.0
LEAST_CONVERGENCE_RAD = 0.02
LARGEST_NUMBER = 1e100
LARGEST_CLOUD = 256 << 20  # bytes
# Cameras around a scene are at most twice as far apart as the middle is far, and that if they are
# two that face each other.
LEAST_DEPTH_SPACINGS = 0.4
LARGEST_MISS = 0.5
# A little nearer and farther than all except the outermost hundredth of what was measured.
NEAR_MARGIN, FAR_MARGIN = 0.8, 1.2
# Of more cameras, the neighbourhoods of some, all over the rig, are matched.
MOST_CAMERAS, NEIGHBOURHOODS, NEIGHBOURS = 48, 12, 3
NEAREST_TRIED = 6  # nearest depths, between a guess and the middle of its range
FEWEST_POINTS = 30  # in the view of a camera whose range is measured
DIGITS = 2  # a range is no more certain, and so it does not hang on the last bits of a match


@dataclass(frozen=True)
class GivenDepthRange:
    """Content of ``depth_range.toml``: least and greatest depth of the scene, world units."""

    near: float
    far: float


def given_depth_range(path: Path) -> tuple[float, float] | None:
    """Return near and far of all cameras as ``depth_range.toml`` in a capture's folder gives them.

    None without that file.
    """
    file = path / DEPTH_RANGE_FILE
    if not file.exists():
        return None
    table = build_table(GivenDepthRange, read_toml(file, CaptureError), str(file), "", CaptureError)
    if not 0 < table.near < table.far:
        raise CaptureError(
            f"{file}: wanted 0 < near < far in world units, got {table.near:g} and {table.far:g}; "
            f"correct it"
        )
    return table.near, table.far


def write_depth_range(path: Path, near: float, far: float) -> None:
    """Write a file that `given_depth_range` reads back."""
    (path / DEPTH_RANGE_FILE).write_text(f"near = {near!r}\nfar = {far!r}\n", encoding="utf-8")


def rig_depth_range(poses: Sequence[Array]) -> list[tuple[float, float]]:
    """Near and far of each camera from the poses alone.

    Args:
        poses: world_to_camera of every camera, each (4, 4).

    Returns:
        (near, far) per camera, world units.

    Reading:
        Where the optical axes converge in front of most cameras, the depth of that point times 1/4
        and 4, which holds a person in a room as well as a street; where they do not, or miss that
        point by over half its depth, 5 and 500 times the median distance of neighbouring cameras.
        One camera alone, or all in one place, gets 0.1 and 100.
    """
    if any(pose.shape != (4, 4) or not (np.abs(pose) < LARGEST_NUMBER).all() for pose in poses):
        return [(0.1, 100.0)] * len(poses)  # invalid poses; `Camera` raises the error
    rotations = np.stack([pose[:3, :3] for pose in poses])
    centres = np.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])
    spacing = float(np.median(neighbour_distances(centres))) if len(centres) > 1 else 0.0
    if spacing == 0:
        return [(0.1, 100.0)] * len(poses)
    axes = rotations[:, 2]
    towards = nearest_to_rays(centres, axes) - centres
    depths = (towards * axes).sum(axis=1)
    typical = float(np.median(depths))
    missed = float(np.median(np.linalg.norm(towards - depths[:, None] * axes, axis=1)))
    is_seen = typical > LEAST_DEPTH_SPACINGS * spacing and missed < LARGEST_MISS * typical
    if _convergence_rad(axes) < LEAST_CONVERGENCE_RAD or not is_seen:
        return [(NEAR_SPACINGS * spacing, FAR_SPACINGS * spacing)] * len(poses)
    # A camera that looks elsewhere gets the range of the others.
    trusted = np.where(
        (depths > typical / FAR_FACTOR) & (depths < typical * FAR_FACTOR), depths, typical
    )
    return [(float(NEAR_FACTOR * depth), float(FAR_FACTOR * depth)) for depth in trusted]


def neighbour_distances(centres: Array) -> Array:
    """Return the distance of each point to its nearest neighbour, (N,); a lone point's is infinite.

    Args:
        centres: (N, 3).
    """
    # A row at a time, as captures can have thousands of poses; the import of a tree would cost more
    # than all of this.
    nearest = np.empty(len(centres))
    for index, centre in enumerate(centres):
        squared = ((centres - centre) ** 2).sum(axis=1)
        squared[index] = np.inf
        nearest[index] = np.sqrt(squared.min())
    return nearest


def _convergence_rad(axes: Array) -> float:
    """Return the median angle between the axes and their mean."""
    mean = axes.mean(axis=0)
    # cameras around the scene look in directions that cancel out
    mean /= max(float(np.linalg.norm(mean)), 1e-12)
    return float(np.median(np.arccos(np.clip(axes @ mean, -1, 1))))


def points_depth_range(
    points_world: Array, pose: Array, K: Array, size: tuple[int, int], fewest: int = 1
) -> tuple[float, float, float] | None:
    """1st, 50th and 99.9th percentile of the depth of the points in a camera's view.

    None if it sees too few.

    Args:
        points_world: (N, 3).
        pose: world_to_camera, (4, 4).
        K: intrinsics, (3, 3).
        size: of the image, pixels.
    """
    points_camera = points_world @ pose[:3, :3].T + pose[:3, 3]
    points_camera = points_camera[points_camera[:, 2] > 0]
    with np.errstate(over="ignore"):
        uv = points_camera[:, :2] / points_camera[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
    depths = points_camera[((uv >= 0) & (uv <= size)).all(axis=1), 2]
    if len(depths) < fewest:
        return None
    nearest, median, farthest = np.percentile(depths, [1.0, 50.0, 99.9])
    return float(nearest), float(median), float(farthest)


def read_points(path: Path) -> Array:
    """Return the vertices of a PLY file, (N, 3)."""
    import trimesh

    try:
        check_plain(path, LARGEST_CLOUD)
        # Without materials: a texture that the file names can be anywhere.
        cloud = trimesh.load(path, process=False, skip_materials=True)
        points = np.asarray(getattr(cloud, "vertices", ()), dtype=np.float64)
    except Exception as error:  # the reader raises any exception on a damaged file
        raise CaptureError(
            f"{path}: wanted a PLY point cloud, got: "
            f"{' '.join(str(error).split())[:120] or type(error).__name__}; restore it"
        ) from error
    if (
        points.ndim != 2
        or points.shape[-1] != 3
        or not np.isfinite(points).all()
        or not len(points)
    ):
        raise CaptureError(
            f"{path}: wanted finite points, got {points.shape} with NaN, infinity or nothing; "
            f"restore it"
        )
    return points


def settle_depth_ranges(capture: Capture, measure: bool = True) -> Capture:
    """Return the capture with the best depth range of each camera that there is.

    What is not given is noted.

    Args:
        measure: match its first frames where a range is not given.

    Reading:
        ``depth_range.toml`` in the capture's folder goes before everything; then what the layout
        gives. Else the first frames of neighbours are matched as `check` does, and each camera
        takes 0.8 times the 1st to 1.2 times the 99.9th percentile of the depth of the triangulated
        points in its view, rounded outwards to two digits. Of fewer than `FEWEST_POINTS` points the
        guess of `rig_depth_range` stays, for which no camera is refused.
    """
    if near_far := given_depth_range(
        capture.path if capture.path.is_dir() else capture.path.parent
    ):
        ranges = {camera.name: near_far for camera in capture.cameras}
        return _ranged(
            capture, ranges, "given", [], f"depth range {_shown([near_far])}, by {DEPTH_RANGE_FILE}"
        )
    guessed = [camera for camera in capture.cameras if camera.range_origin == "guessed"]
    if not guessed:
        return capture
    points = matched_points(capture) if measure else np.empty((0, 3))
    matched, medians = {}, []
    for camera in guessed:
        depths = points_depth_range(
            points, camera.world_to_camera, camera.K, camera.size, FEWEST_POINTS
        )
        if depths is not None:
            matched[camera.name] = (
                _rounded(NEAR_MARGIN * depths[0], False),
                _rounded(FAR_MARGIN * depths[2], True),
            )
            medians.append(depths[1])
    if matched:
        note = (
            f"depth range of {_cameras(capture, matched)} measured on matched points: "
            f"{_shown(matched.values())}"
        )
        capture = _ranged(capture, matched, "measured", medians, note)
    left = [
        _matchable(camera, capture.cameras)
        for camera in capture.cameras
        if camera.range_origin == "guessed"
    ]
    if not left or not measure:
        return capture
    by_name = {camera.name: camera for camera in left}
    capture = replace(
        capture, cameras=tuple(by_name.get(camera.name, camera) for camera in capture.cameras)
    )
    guess = _shown([(camera.near, camera.far) for camera in left])
    return capture.noted(
        f"depth range of {_cameras(capture, [camera.name for camera in left])} guessed from the "
        f"viewing directions: {guess}; {RANGE_MEND}"
    )


def matched_points(capture: Capture) -> Array:
    """Return the points that the first frames of neighbouring cameras share, triangulated, (N, 3)
    in the world.
    """
    cameras = _neighbourhoods(capture.cameras)
    features = [_features(capture, camera.name) for camera in cameras]
    points = [np.empty((0, 3))]
    for first, second in neighbour_pairs(cameras, NEIGHBOURS):
        camera, partner = cameras[first], cameras[second]
        pair = match_pair(
            first, second, features[first], features[second], max(*camera.size, *partner.size)
        )
        if pair is not None:
            sound, depth, _ = sound_matches(camera, partner, pair)
            points.append(camera.unproject(pair.uv_first[sound], depth[sound]))
    return np.concatenate(points)


def _neighbourhoods(cameras: Sequence[Camera]) -> list[Camera]:
    """Return all cameras of a rig; of a large one some all over it, each with its nearest."""
    if len(cameras) <= MOST_CAMERAS:
        return list(cameras)
    centres = np.stack([camera.centre for camera in cameras])
    middles = np.linspace(0, len(cameras) - 1, NEIGHBOURHOODS).round().astype(int)
    near = [
        np.linalg.norm(centres - centres[middle], axis=1).argsort(kind="stable")[: NEIGHBOURS + 1]
        for middle in middles
    ]
    return [
        cameras[index]
        for index in sorted({int(index) for neighbours in near for index in neighbours})
    ]


def _matchable(camera: Camera, cameras: Sequence[Camera]) -> Camera:
    """A camera of a guessed range, its near so far off that it overlaps with a neighbour there:
    nothing is known of nearer.
    """
    partners = sorted(
        (partner for partner in cameras if partner is not camera),
        key=lambda partner: remoteness(camera, partner),
    )
    for near in np.geomspace(camera.near, (camera.near * camera.far) ** 0.5, NEAREST_TRIED):
        nearer = replace(camera, near=float(near))
        if any(can_rectify(nearer, partner, nearest=1.0) for partner in partners[:NEIGHBOURS]):
            return nearer
    return camera


def _features(capture: Capture, name: str) -> Features:
    """Return the features of a camera's first frame; none if unreadable (reported elsewhere)."""
    try:
        return find_features(capture.frame(name, 0))
    except CaptureError:
        return Features(
            np.empty((0, 2)), np.empty((0, 128), np.float32), np.empty((0, 3), np.float32)
        )


def _ranged(
    capture: Capture,
    ranges: Mapping[str, tuple[float, float]],
    origin: RangeOrigin,
    medians: Sequence[float],
    note: str,
) -> Capture:
    """Return the capture with the near and far of some cameras replaced, and the guess of its units
    with them.
    """
    cameras = [
        replace(
            camera, near=ranges[camera.name][0], far=ranges[camera.name][1], range_origin=origin
        )
        if camera.name in ranges
        else camera
        for camera in capture.cameras
    ]
    units = capture.units_per_metre
    if capture.units_origin == GUESSED and any(
        camera.range_origin == "guessed" for camera in capture.cameras
    ):
        units = guess_units_per_metre(cameras, medians)
    return replace(capture, cameras=tuple(cameras), units_per_metre=units).noted(note)


def _rounded(depth: float, upwards: bool) -> float:
    """Return two significant digits, from below or above."""
    step = 10.0 ** (np.floor(np.log10(depth)) - DIGITS + 1)
    return float(f"{(np.ceil if upwards else np.floor)(depth / step) * step:.{DIGITS}g}")


def _shown(ranges: Iterable[tuple[float, float]]) -> str:
    nears, fars = zip(*ranges, strict=True)
    return f"{min(nears):.3g} .. {max(fars):.3g}"


def _cameras(capture: Capture, names: Collection[str]) -> str:
    return "all cameras" if len(names) == len(capture.cameras) else listed(list(names))
