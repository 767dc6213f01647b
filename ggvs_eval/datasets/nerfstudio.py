"""nerfstudio captures: ``transforms.json`` with one image per fixed camera."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import LARGEST_DEVIATION, Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size
from ggvs_eval.datasets.camera_frames import require_frames
from ggvs_eval.datasets.colmap_model import undistorted_sources
from ggvs_eval.datasets.depth_range import rig_depth_range
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.names import camera_names
from ggvs_eval.files.plain import read_plain_text
from ggvs_eval.lens import Lens

TRANSFORMS = "transforms.json"
PINHOLE_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL")
# OpenGL's camera looks along -z with y up, ours along +z with y down.
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def refuse(path: Path) -> str | None:
    """Return the reason why this is not a nerfstudio capture, or None if it is one."""
    return None if (path / TRANSFORMS).is_file() else f"no {TRANSFORMS}"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a nerfstudio capture of a fixed rig; cameras are called as their images or folders, in the order of names.

    Frames are those of `require_frames`: videos or image folders of that name, else the one image itself.

    Args:
        path: folder that holds ``transforms.json``.
        units: world units per metre or a file that says how to measure them; see `choose_units`.

    Raises:
        CaptureError: damaged JSON, a camera without pose, intrinsics or frames, or a camera model that OpenCV cannot express.

    Reading:
        The file gives no depth range: that of `rig_depth_range` is taken.
    """
    file = path / TRANSFORMS
    try:
        values = dict(json.loads(read_plain_text(file)))
        check_rig_size(path, len(values["frames"]))
        images = [frame["file_path"].replace("\\", "/") for frame in values["frames"]]
        described = [(image, {**values, **frame}) for image, frame in zip(images, values["frames"], strict=True)]
        frames = dict(zip(camera_names(images), described, strict=True))
        if len(frames) != len(values["frames"]) or not frames:
            raise ValueError(f"{len(values['frames'])} frames of {len(frames)} cameras")
        poses = {name: _world_to_camera(frame) for name, (_, frame) in frames.items()}
        lenses = {name: _lens(frame) for name, (_, frame) in frames.items()}
    except (OSError, ValueError, TypeError, KeyError, ArithmeticError, RecursionError, AttributeError, CameraError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise CaptureError(
            f"{file}: wanted frames with poses and intrinsics, one per camera, got: {reason:.200}; export it again"
        ) from error
    names = sorted(frames)
    cameras = _cameras(names, poses, lenses, file)
    sources = require_frames(path, {name: frames[name][0] for name in names}).sources
    pinhole = undistorted_sources(list(sources.values()), [lenses[name] for name in names], cameras)
    return assemble_capture(path, "nerfstudio", cameras, pinhole, choose_units(path, units, cameras))


def _cameras(names: list[str], poses: Mapping[str, Array], lenses: Mapping[str, Lens], file: Path) -> list[Camera]:
    ranges = rig_depth_range([poses[name] for name in names])
    try:
        return [
            Camera(name, lenses[name].undistorted_K(), poses[name], lenses[name].width, lenses[name].height, *depths)
            for name, depths in zip(names, ranges, strict=True)
        ]
    except CameraError as error:
        raise CaptureError(f"{file}: {error}") from error


def _world_to_camera(frame: Mapping[str, Any]) -> Array:
    camera_to_world = np.array(frame["transform_matrix"], dtype=np.float64)
    if camera_to_world.shape != (4, 4) or not np.isfinite(camera_to_world).all():
        raise ValueError(f"the transform_matrix of {frame['file_path']} is not 4 x 4 finite numbers")
    scale = np.linalg.norm(camera_to_world[:3, :3], axis=0)
    if not np.allclose(scale, 1.0, atol=2 * LARGEST_DEVIATION) or not np.array_equal(camera_to_world[3], (0, 0, 0, 1)):
        defects = f"axes of length {', '.join(f'{length:.4g}' for length in scale)}, last row {camera_to_world[3].tolist()}"
        raise ValueError(f"the transform_matrix of {frame['file_path']} is not rigid ({defects})")
    return np.asarray(np.linalg.inv(camera_to_world @ OPENGL_TO_OPENCV), dtype=np.float64)


def _lens(frame: Mapping[str, Any]) -> Lens:
    """The lens of a frame; what it does not say itself stands at the top of the file."""
    model = frame.get("camera_model", "OPENCV")
    width, height = int(frame["w"]), int(frame["h"])
    fx = float(frame["fl_x"]) if "fl_x" in frame else width / 2 / math.tan(float(frame["camera_angle_x"]) / 2)
    fy = float(frame.get("fl_y", fx))
    K = np.array([[fx, 0, float(frame.get("cx", width / 2))], [0, fy, float(frame.get("cy", height / 2))], [0, 0, 1.0]])
    names = ("k1", "k2", "k3", "k4") if model == "OPENCV_FISHEYE" else ("k1", "k2", "p1", "p2", "k3")
    if model not in (*PINHOLE_MODELS, "OPENCV_FISHEYE"):
        raise ValueError(f"camera_model {model!r}, known are {', '.join((*PINHOLE_MODELS, 'OPENCV_FISHEYE'))}")
    if model != "OPENCV_FISHEYE" and frame.get("k4", 0):
        raise ValueError(f"k4 = {frame['k4']!r:.40} of {model}, which programs read differently; undistort the images")
    coefficients = tuple(float(frame.get(name, 0.0)) for name in names)
    return Lens(K, "fisheye" if model == "OPENCV_FISHEYE" else "opencv", coefficients, width, height)
