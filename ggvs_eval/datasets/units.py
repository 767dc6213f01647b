"""World units per metre: given, measured between two cameras or two marked points, known of a data
set, or guessed.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.plain import read_plain_text
from ggvs_eval.files.toml_tables import read_toml

DEMO_NOTES = "demo.json"
UNITS_FILE = "units.toml"
WAYS = (
    "units_per_metre = NUMBER, or [baseline] with cameras and metres, or [points] with metres, "
    "a and b"
)
GivenUnits = float | Path | None


@dataclass(frozen=True)
class Units:
    """World units per metre and where the number comes from."""

    per_metre: float
    origin: str


METRIC = Units(1.0, "assumed of its form, which is that of a metric data set")
GUESSED = "guess: median scene depth taken for 2 m"


def choose_units(
    path: Path,
    units: GivenUnits,
    cameras: Sequence[Camera],
    *,
    of_data_set: Units | None = None,
    median_depths: Sequence[float] | None = None,
) -> Units:
    """Return the world units per metre, from the best that there is.

    In this order: what the user gives (a number or a TOML file), ``units.toml`` in the capture,
    ``demo.json`` of a synthetic capture, what is known of the data set, a guess from the depth of
    the scene.

    Args:
        median_depths: median scene depth per camera, world units, for the guess.
    """
    file = units if isinstance(units, Path) else path / UNITS_FILE
    if isinstance(units, Path) or (units is None and file.is_file()):
        return _measured_units(file, cameras)
    if units is not None:
        return Units(_positive(units, path, "world units per metre"), "given by the user")
    noted = read_note(path, "units_per_metre")
    if noted is not None:
        return Units(_positive(noted, path / DEMO_NOTES, "world units per metre"), DEMO_NOTES)
    return of_data_set or Units(guess_units_per_metre(cameras, median_depths), GUESSED)


def guess_units_per_metre(
    cameras: Sequence[Camera], median_depths: Sequence[float] | None = None
) -> float:
    """Return the world units per metre where nothing better is known: the median depth of the scene
    is taken for 2 metres.

    Args:
        median_depths: median scene depth per camera in world units; the geometric mean of near and
            far where absent.

    Reading:
        The paper's constants are metres and its COLMAP captures are not; method.md 3.2 resolves it
        by the ratio of ScanNet, tau / median depth = 0.01. On the one rig with a known scale this
        gives 7.3 units per metre for 10.5 true ones.
    """
    depths = median_depths or [
        float(np.sqrt(camera.near) * np.sqrt(camera.far)) for camera in cameras
    ]
    return float(np.median(depths)) / 2.0


def read_note(path: Path, key: str) -> float | None:
    """Return a number that a synthetic capture notes about itself in ``demo.json``.

    None if there is no such file or note.
    """
    file = path / DEMO_NOTES
    if not file.is_file():
        return None
    try:
        note = dict(json.loads(read_plain_text(file))).get(key)
        return None if note is None else float(note)
    except (OSError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise CaptureError(
            f"{file}: wanted a number {key}, got: {error}; write the demo capture again"
        ) from error


def nearest_to_rays(centres: Array, rays: Array, weights: Array | float = 1.0) -> Array:
    """Return the point nearest to rays of any length, (3,), from their centres, (N, 3) both, by
    their weights, (N, 1, 1).
    """
    axes = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    # (N, 3, 3), onto each ray's normal plane
    across = weights * (np.eye(3) - axes[:, :, None] * axes[:, None, :])
    return np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, centres), rcond=None)[
        0
    ]


def triangulate(cameras: Sequence[Camera], uv: Array) -> tuple[Array, float]:
    """Return the point nearest to the rays of one marked point in several images.

    Args:
        cameras: at least two, at different places.
        uv: where each sees the point, (N, 2), pixels.

    Returns:
        The point in the world, (3,), and the largest distance in pixels between a mark and the
        point's image.
    """
    rays = np.stack(
        [
            camera.unproject(mark, np.array(1.0)) - camera.centre
            for camera, mark in zip(cameras, uv, strict=True)
        ]
    )
    point = nearest_to_rays(np.stack([camera.centre for camera in cameras]), rays)
    missed = [
        np.linalg.norm(camera.project(point)[0] - mark)
        for camera, mark in zip(cameras, uv, strict=True)
    ]
    return point, float(max(missed))


def _measured_units(file: Path, cameras: Sequence[Camera]) -> Units:
    """Read the units from a TOML file that gives them in one of three ways."""
    values = read_toml(file, CaptureError)
    if len(values) != 1 or not set(values) <= {"units_per_metre", "baseline", "points"}:
        raise CaptureError(
            f"{file}: wanted exactly one of {WAYS}, got {', '.join(values) or 'nothing'}; keep one"
        )
    by_name = {camera.name: camera for camera in cameras}
    try:
        if "baseline" in values:
            return _from_baseline(values["baseline"], by_name, file)
        if "points" in values:
            return _from_points(values["points"], by_name, file)
        return Units(_positive(values["units_per_metre"], file, "world units per metre"), file.name)
    except (KeyError, TypeError, ValueError, OverflowError, CameraError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise CaptureError(
            f"{file}: wanted {WAYS}, got: {reason}; the cameras are {', '.join(by_name)}"
        ) from error


def _from_baseline(table: Mapping[str, Any], cameras: Mapping[str, Camera], file: Path) -> Units:
    first, second = table["cameras"]
    distance = float(np.linalg.norm(cameras[first].centre - cameras[second].centre))
    metres = _positive(table["metres"], file, "metres between the cameras")
    units = _positive(distance / metres, file, f"world units between {first} and {second}")
    return Units(units, f"baseline {first} - {second} of {metres:g} m")


def _from_points(table: Mapping[str, Any], cameras: Mapping[str, Camera], file: Path) -> Units:
    metres = _positive(table["metres"], file, "metres between the points")
    points, missed = zip(
        *(_marked_point(table, point, cameras, file) for point in ("a", "b")), strict=True
    )
    units = _positive(
        float(np.linalg.norm(points[0] - points[1])) / metres,
        file,
        "world units between the points",
    )
    return Units(
        units, f"two marked points {metres:g} m apart, their rays meet within {max(missed):.1f} px"
    )


def _marked_point(
    table: Mapping[str, Any], point: str, cameras: Mapping[str, Camera], file: Path
) -> tuple[Array, float]:
    marks = dict(table[point])
    if len(marks) < 2:
        raise CaptureError(
            f"{file}: points.{point} wanted in at least two cameras, got {len(marks)}; mark it in "
            f"another"
        )
    seen_by = [cameras[name] for name in marks]
    if "size" in table:
        seen_by = [camera.resized(*map(int, table["size"])) for camera in seen_by]
    uv = np.array(list(marks.values()), dtype=np.float64).reshape(len(marks), 2)
    return triangulate(seen_by, uv)


def _positive(value: object, path: Path, quantity: str) -> float:
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not 0 < value <= sys.float_info.max
    ):
        raise CaptureError(
            f"{path}: wanted a positive number of {quantity}, got {value!r:.80}; correct or drop it"
        )
    return float(value)
