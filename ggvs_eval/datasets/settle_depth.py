"""Near and far of a capture's cameras: given by a file, by the layout, measured on the pictures, or guessed."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, RangeOrigin
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import listed
from ggvs_eval.datasets.depth_range import (
    DEPTH_RANGE_FILE,
    FAR_MARGIN,
    NEAR_MARGIN,
    RANGE_MEND,
    given_depth_range,
    points_depth_range,
)
from ggvs_eval.datasets.units import GUESSED, guess_units_per_metre
from ggvs_eval.errors import CaptureError
from ggvs_eval.geometry.epipolar import match_pair, neighbour_pairs, remoteness, sound_matches
from ggvs_eval.geometry.features import Features, find_features
from ggvs_eval.geometry.rectification import can_rectify

# Of more cameras, the neighbourhoods of some, all over the rig, are matched.
MOST_CAMERAS, NEIGHBOURHOODS, NEIGHBOURS = 48, 12, 3
NEAREST_TRIED = 6  # nearest depths, between a guess and the middle of its range
FEWEST_POINTS = 30  # in the view of a camera whose range is measured
DIGITS = 2  # a range is no more certain, and so it does not hang on the last bits of a match


def settle_depth_ranges(capture: Capture, measure: bool = True) -> Capture:
    """The capture with the best depth range of each camera that there is; what is not given is noted.

    Args:
        measure: match its first frames where a range is not given.

    Reading:
        ``depth_range.toml`` in the capture's folder goes before everything; then what the layout gives. Else the first frames of
        neighbours are matched as `check` does, and each camera takes 0.8 times the 1st to 1.2 times the 99.9th percentile of the
        depth of the triangulated points in its view, rounded outwards to two digits. Of fewer than `FEWEST_POINTS` points the
        guess of `rig_depth_range` stays, for which no camera is refused.
    """
    if given := given_depth_range(capture.path if capture.path.is_dir() else capture.path.parent):
        ranges = {camera.name: given for camera in capture.cameras}
        return _ranged(capture, ranges, "given", [], f"depth range {_shown([given])}, as {DEPTH_RANGE_FILE} says")
    guessed = [camera for camera in capture.cameras if camera.range_origin == "guessed"]
    if not guessed:
        return capture
    points = matched_points(capture) if measure else np.empty((0, 3))
    measured, medians = {}, []
    for camera in guessed:
        seen = points_depth_range(points, camera.world_to_camera, camera.K, camera.size, FEWEST_POINTS)
        if seen is not None:
            measured[camera.name] = _rounded(NEAR_MARGIN * seen[0], False), _rounded(FAR_MARGIN * seen[2], True)
            medians.append(seen[1])
    if measured:
        note = f"depth range of {_cameras(capture, measured)} measured on matched points: {_shown(measured.values())}"
        capture = _ranged(capture, measured, "measured", medians, note)
    left = [_matchable(camera, capture.cameras) for camera in capture.cameras if camera.range_origin == "guessed"]
    if not left or not measure:
        return capture
    by_name = {camera.name: camera for camera in left}
    capture = replace(capture, cameras=tuple(by_name.get(camera.name, camera) for camera in capture.cameras))
    guess = _shown([(camera.near, camera.far) for camera in left])
    return capture.noted(
        f"depth range of {_cameras(capture, [camera.name for camera in left])} guessed from where the cameras look: {guess}; "
        f"{RANGE_MEND}"
    )


def matched_points(capture: Capture) -> Array:
    """Points that the first frames of neighbouring cameras share, triangulated, (N, 3) in the world."""
    cameras = _neighbourhoods(capture.cameras)
    features = [_features(capture, camera.name) for camera in cameras]
    points = [np.empty((0, 3))]
    for first, second in neighbour_pairs(cameras, NEIGHBOURS):
        one, other = cameras[first], cameras[second]
        pair = match_pair(first, second, features[first], features[second], max(*one.size, *other.size))
        if pair is not None:
            sound, depth, _ = sound_matches(one, other, pair)
            points.append(one.unproject(pair.uv_first[sound], depth[sound]))
    return np.concatenate(points)


def _neighbourhoods(cameras: Sequence[Camera]) -> list[Camera]:
    """All cameras of a rig; of a large one some all over it, each with its nearest."""
    if len(cameras) <= MOST_CAMERAS:
        return list(cameras)
    centres = np.stack([camera.centre for camera in cameras])
    middles = np.linspace(0, len(cameras) - 1, NEIGHBOURHOODS).round().astype(int)
    near = [np.linalg.norm(centres - centres[middle], axis=1).argsort(kind="stable")[: NEIGHBOURS + 1] for middle in middles]
    return [cameras[index] for index in sorted({int(index) for each in near for index in each})]


def _matchable(camera: Camera, cameras: Sequence[Camera]) -> Camera:
    """A camera of a guessed range, its near so far off that it overlaps with a neighbour there: nothing is known of nearer."""
    others = sorted((other for other in cameras if other is not camera), key=lambda other: remoteness(camera, other))
    for near in np.geomspace(camera.near, (camera.near * camera.far) ** 0.5, NEAREST_TRIED):
        nearer = replace(camera, near=float(near))
        if any(can_rectify(nearer, other, nearest=1.0) for other in others[:NEIGHBOURS]):
            return nearer
    return camera


def _features(capture: Capture, name: str) -> Features:
    """Features of a camera's first frame; none where it cannot be read, which others say better."""
    try:
        return find_features(capture.frame(name, 0))
    except CaptureError:
        return Features(np.empty((0, 2)), np.empty((0, 128), np.float32), np.empty((0, 3), np.float32))


def _ranged(
    capture: Capture, ranges: Mapping[str, tuple[float, float]], origin: RangeOrigin, medians: Sequence[float], note: str
) -> Capture:
    """The capture with the near and far of some cameras replaced, and the guess of its units with them."""
    cameras = [
        replace(camera, near=ranges[camera.name][0], far=ranges[camera.name][1], range_origin=origin)
        if camera.name in ranges
        else camera
        for camera in capture.cameras
    ]
    units = capture.units_per_metre
    if capture.units_origin == GUESSED and any(camera.range_origin == "guessed" for camera in capture.cameras):
        units = guess_units_per_metre(cameras, medians)
    return replace(capture, cameras=tuple(cameras), units_per_metre=units).noted(note)


def _rounded(depth: float, upwards: bool) -> float:
    """Two significant digits, from below or above."""
    step = 10.0 ** (np.floor(np.log10(depth)) - DIGITS + 1)
    return float(f"{(np.ceil if upwards else np.floor)(depth / step) * step:.{DIGITS}g}")


def _shown(ranges: Iterable[tuple[float, float]]) -> str:
    nears, fars = zip(*ranges, strict=True)
    return f"{min(nears):.3g} .. {max(fars):.3g}"


def _cameras(capture: Capture, names: Collection[str]) -> str:
    return "all cameras" if len(names) == len(capture.cameras) else listed(list(names))
