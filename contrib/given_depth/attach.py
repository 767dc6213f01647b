"""A capture with depth from elsewhere, in world units: one factor for all cameras, fitted to points
that neighbours share.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, Extras, GivenDepth
from ggvs_eval.contrib.given_depth.depth_files import MapFiles, find_maps, z_per_distance
from ggvs_eval.datasets.depth_range import matched_points
from ggvs_eval.errors import CaptureError

FEWEST_POINTS = 30  # that a factor is fitted to
# Ray lengths are suspected if they fit this many times better than z, and z is off by this much.
CLEARLY_BETTER, LEAST_ERROR = 0.7, 0.005


def attach_depth(capture: Capture, depth_files: GivenDepth) -> Capture:
    """The capture with the depth of some or all cameras from files, as if a sensor had measured it.

    Args:
        depth_files: folder, factor and meaning of the numbers.

    Raises:
        CaptureError: no maps, maps of another number than frames, or too few points to fit a
            factor.

    Reading:
        Maps of networks are true up to a factor that all cameras of a scene share. It is the
        median, over points that pairs of neighbours triangulate in their first frames, of the
        triangulated z divided by the map's; occluded points and outliers hardly move a median. The
        remaining error is the median of the absolute relative differences.
    """
    folder = Path(depth_files.folder)
    maps = {
        name: MapFiles(files, capture.camera(name), is_distance=depth_files.is_distance)
        for name, files in find_maps(folder, capture.camera_names).items()
    }
    for name, source in maps.items():
        if source.n_frames < capture.n_frames:
            raise CaptureError(
                f"{folder}: wanted {capture.n_frames} depth maps of {name}, one per frame, got "
                f"{source.n_frames}; add the others"
            )
    longer = [name for name, source in maps.items() if source.n_frames > capture.n_frames]
    points = matched_points(capture)
    pairs = {name: _pairs(capture.camera(name), source, points) for name, source in maps.items()}
    factor, notes = _fit(folder, depth_files, pairs, maps)
    if longer:
        notes.append(
            f"{folder}: {maps[longer[0]].n_frames} depth maps of {longer[0]} for "
            f"{capture.n_frames} frames: the first ones are used, {maps[longer[0]].files[0].name} "
            "for frame 0; if the frames begin later, give a folder that begins with them"
        )
    extras = capture.extras or tuple(Extras() for _ in capture.cameras)
    attached = tuple(
        replace(extra, depth=replace(maps[name], scale=factor)) if name in maps else extra
        for name, extra in zip(capture.camera_names, extras, strict=True)
    )
    if lacking := [name for name in capture.camera_names if name not in maps]:
        notes.append(f"{folder}: no depth of {', '.join(lacking)}, which get it as without --depth")
    return replace(
        capture, extras=attached, given_depth=depth_files, notes=(*capture.notes, *notes)
    )


def _pairs(camera: Camera, source: MapFiles, points: Array) -> Array:
    """Triangulated z, the map's number there as z, and as the length of a ray, of each point in a
    camera's view, (N, 3).
    """
    depth = next(source.depths(0, 1))
    height, width = depth.shape
    view = camera.resized(width, height)
    uv, z = view.project(points)
    columns, rows = np.floor(uv[:, 0]).astype(int), np.floor(uv[:, 1]).astype(int)
    inside = (z > 0) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    columns, rows = columns[inside], rows[inside]
    at = depth[rows, columns].astype(np.float64)
    slope = z_per_distance(camera, depth.shape)[rows, columns]
    # the other meaning of the same numbers
    as_ray = at / slope if source.is_distance else at * slope
    triples = np.stack([z[inside], at, as_ray], axis=1)
    return triples[at > 0]


def _fit(
    folder: Path, depth_files: GivenDepth, pairs: Mapping[str, Array], maps: Mapping[str, MapFiles]
) -> tuple[float, list[str]]:
    """The factor, and what is said of it."""
    together = np.concatenate(list(pairs.values())) if pairs else np.empty((0, 3))
    if len(together) < FEWEST_POINTS:
        if depth_files.scale:
            return depth_files.scale, [
                f"{folder}: too few points in common with the pictures to check the factor "
                f"{depth_files.scale:g}"
            ]
        raise CaptureError(
            f"{folder}: wanted {FEWEST_POINTS} points of neighbouring cameras to align depth with, "
            f"got {len(together)}; give --depth-scale, world units per unit of the files"
        )
    fitted, error = _factor(together[:, 0], together[:, 1])
    other_factor, other_error = _factor(together[:, 0], together[:, 2])
    single = [
        _factor(pair[:, 0], pair[:, 1])[0] for pair in pairs.values() if len(pair) >= FEWEST_POINTS
    ]
    spread = (max(single) / min(single) - 1) * 100 if single else 0.0
    factor = depth_files.scale or fitted
    summary = (
        f"{folder}: depth of {len(maps)} cameras in "
        f"{'lengths of rays' if depth_files.is_distance else 'z'}; {len(together)} triangulated "
        f"points fit a factor of {fitted:.5g}, cameras differ by {spread:.1f} %, median error "
        f"{100 * error:.2f} %"
    )
    usage = (
        f"used is {depth_files.scale:g}, {100 * (depth_files.scale / fitted - 1):+.1f} %"
        if depth_files.scale
        else "used"
    )
    notes = [f"{summary}; {usage}"]
    if error > LEAST_ERROR and other_error < CLEARLY_BETTER * error:
        better = "z" if depth_files.is_distance else "distance"
        notes.append(
            f"{folder}: numbers fit better as "
            f"{'z' if depth_files.is_distance else 'lengths of rays'} (median error "
            f"{100 * other_error:.2f} % instead of {100 * error:.2f} %, factor "
            f"{other_factor:.5g}); try --depth-is {better}"
        )
    return factor, notes


def _factor(z: Array, values: Array) -> tuple[float, float]:
    """Median factor from values to z, and the median absolute relative error that remains."""
    factor = float(np.median(z / values))
    return factor, float(np.median(np.abs(values * factor / z - 1)))
