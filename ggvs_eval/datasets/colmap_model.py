"""COLMAP sparse models: read as views with pose, pinhole intrinsics, lens and depth range, and written as text files."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import pinhole_K
from ggvs_eval.datasets.assemble import check_rig_size
from ggvs_eval.datasets.depth_range import FAR_MARGIN, NEAR_MARGIN
from ggvs_eval.datasets.rig import RigCamera
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.lens import Lens, LensModel
from ggvs_eval.side_process import SideProcess, SideProcessError

READER_TIMEOUT_S = 600
_READER = SideProcess(Path(__file__).with_name("colmap_reader.py"))  # by its file: its name would import every other reader
# COLMAP's lenses that OpenCV can express, with their parameters in order.
LENSES = """
    SIMPLE_PINHOLE f cx cy
    PINHOLE fx fy cx cy
    SIMPLE_RADIAL f cx cy k1
    RADIAL f cx cy k1 k2
    OPENCV fx fy cx cy k1 k2 p1 p2
    FULL_OPENCV fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
    SIMPLE_RADIAL_FISHEYE f cx cy k1
    RADIAL_FISHEYE f cx cy k1 k2
    OPENCV_FISHEYE fx fy cx cy k1 k2 k3 k4"""
COEFFICIENTS = {"fisheye": "k1 k2 k3 k4", "opencv": "k1 k2 p1 p2", "rational": "k1 k2 p1 p2 k3 k4 k5 k6"}
FILES = ("cameras.txt", "images.txt", "points3D.txt")


@dataclass(frozen=True, eq=False)
class CalibratedView:
    """One registered image of a model.

    Attributes:
        image_name: as the model calls it.
        world_to_camera: rigid transform, (4, 4).
        lens: intrinsics and distortion at the size of the calibration.
        depth_percentiles: 1st, 50th and 99th percentile of the depth of the points it sees, world units; None if it sees none.
        quaternion_length: of its rotation as the file has it, which is brought to 1.
    """

    image_name: str
    world_to_camera: Array
    lens: Lens
    depth_percentiles: tuple[float, float, float] | None
    quaternion_length: float = 1.0


def rig_of_views(views: Mapping[str, CalibratedView]) -> list[RigCamera]:
    """Return the rig of named views.

    Reading:
        near = 0.8 times the 1st, far = 1.2 times the 99th percentile of the depth of the points that a view sees. Points are for
        depth ranges alone: a view that sees none has none, as a model of known poses before triangulation.
    """
    rig = []
    for name, view in views.items():
        seen = view.depth_percentiles
        near_far = (NEAR_MARGIN * seen[0], FAR_MARGIN * seen[2]) if seen else None
        rig.append(RigCamera(name, view.lens, view.world_to_camera, near_far))
    return rig


def median_depths(views: Iterable[CalibratedView]) -> list[float]:
    """Return the median depth of the points of each view that sees any, world units."""
    return [view.depth_percentiles[1] for view in views if view.depth_percentiles]


def read_model(folder: Path) -> list[CalibratedView]:
    """Return the registered images of a model in the order of their names.

    Args:
        folder: holds cameras, images and perhaps points3D, as text or binary.
    """
    try:
        images = _READER.ask(folder, READER_TIMEOUT_S)
    except TimeoutError as error:
        raise CaptureError(
            f"{folder}: damaged COLMAP model, reading it took over {READER_TIMEOUT_S} s; export it again"
        ) from error
    except SideProcessError as error:
        raise CaptureError(
            f"{folder}: damaged COLMAP model, the reader reports '{error!s:.200}'; copy or export the model again"
        ) from error
    check_rig_size(folder, len(images))
    if not images:
        raise CaptureError(f"{folder}: wanted one registered image per fixed camera, got none; calibrate again")
    return [_view(folder, image) for image in images]


def _view(folder: Path, image: dict[str, Any]) -> CalibratedView:
    name = image["name"]
    world_to_camera = np.vstack([image["world_to_camera"], [0.0, 0.0, 0.0, 1.0]])
    try:
        lens = lens_of_colmap(image["model"], image["params"], image["width"], image["height"])
    except CameraError as error:
        raise CaptureError(f"{folder}: {name}: {error}") from error
    return CalibratedView(name, world_to_camera, lens, tuple(image["depth_percentiles"]) or None, image["quaternion_length"])


def lens_of_colmap(model: str, params: Sequence[float], width: int, height: int) -> Lens:
    """Return the lens of a COLMAP camera.

    Raises:
        CameraError: a model that OpenCV cannot express, or parameters that do not fit it.
    """
    lenses = {name: keys for name, *keys in map(str.split, LENSES.strip().splitlines())}
    if model not in lenses:
        remedy = "undistort images and model by 'colmap image_undistorter' first"
        raise CameraError(f"wanted one of {', '.join(lenses)}, got {model}; {remedy}")
    if len(params) != len(lenses[model]) or not np.isfinite(params).all():
        raise CameraError(f"wanted {len(lenses[model])} finite parameters of {model}, got {list(params)}")
    values = dict(zip(lenses[model], map(float, params), strict=True))
    kind: LensModel = "fisheye" if model.endswith("FISHEYE") else "opencv"
    keys = COEFFICIENTS["rational" if "k6" in values else kind].split()
    fx, fy = (values.get(key, values.get("f", 0.0)) for key in ("fx", "fy"))
    return Lens(pinhole_K(fx, fy, values["cx"], values["cy"]), kind, tuple(values.get(key, 0.0) for key in keys), width, height)
