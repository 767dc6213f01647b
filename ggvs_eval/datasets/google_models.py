"""``models.json`` of Google's light-field data sets, Spaces and Immersive: the calibration of each camera, in metres."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.plain import read_plain_text

MODELS = "models.json"
# What every camera of the file must say, and how many numbers each is.
NUMBERS = {
    "principal_point": 2,
    "pixel_aspect_ratio": 1,
    "focal_length": 1,
    "position": 3,
    "orientation": 3,
    "width": 1,
    "height": 1,
}


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Calibration of one camera.

    Attributes:
        K: intrinsics for an image of width x height, (3, 3).
        world_to_camera: rigid transform, (4, 4), metres.
        width: of the image that was calibrated, not always a whole number of pixels.
    """

    K: Array
    world_to_camera: Array
    width: float
    height: float


def load_models(file: Path) -> Any:
    """Read the file as it stands."""
    try:
        return json.loads(read_plain_text(file))
    except (OSError, ValueError, RecursionError) as error:
        reason = "lists nested too deep" if isinstance(error, RecursionError) else str(error)
        raise CaptureError(f"{file}: wanted JSON, got: {reason}; copy the scene again") from error


def read_camera_model(file: Path, model: Any, where: str) -> CameraModel:
    """Read the calibration of one camera.

    Raises:
        CaptureError: a key that is absent or holds something else than finite numbers, or no size.

    Reading:
        ``orientation`` is the rotation vector of world to camera, ``position`` the camera's centre, and the principal point
        counts from the image's corner.
    """
    values = {key: read_numbers(file, model, key, count, where) for key, count in NUMBERS.items()}
    focal_px, aspect = *values["focal_length"], *values["pixel_aspect_ratio"]
    (cx, cy), (width,), (height,) = values["principal_point"], values["width"], values["height"]
    if width < 1 or height < 1:
        raise CaptureError(f"{file}: wanted a size of {where}, got {width:g} x {height:g}; copy the scene again")
    rotation = cv2.Rodrigues(np.array(values["orientation"]))[0]
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation
    world_to_camera[:3, 3] = -rotation @ values["position"]
    K = np.array([[focal_px, 0.0, cx], [0.0, focal_px * aspect, cy], [0.0, 0.0, 1.0]])
    return CameraModel(K, world_to_camera, width, height)


def read_numbers(file: Path, model: Any, key: str, count: int, where: str) -> list[float]:
    """Read `count` numbers of one key, whether the file holds a list or a single one; otherwise as `read_camera_model`."""
    value = model.get(key) if isinstance(model, Mapping) else None
    numbers: list[Any] = value if isinstance(value, list) else [value]
    right = len(numbers) == count and all(isinstance(each, int | float) and not isinstance(each, bool) for each in numbers)
    # Beyond this nothing is a length or an angle, and whole numbers may not even fit a float.
    if not right or not all(abs(each) < 1e9 for each in numbers):
        requirement = f"{count} finite numbers" if count > 1 else "a finite number"
        content = f"{value!r:.60}" if isinstance(model, Mapping) else f"{model!r:.60} for the camera"
        raise CaptureError(f"{file}: wanted {requirement} as {key} of {where}, got {content}; copy the scene again")
    return [float(each) for each in numbers]
