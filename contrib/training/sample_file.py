"""Files of training samples: named arrays, the cameras among them, whole or not there at all."""

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.atomic import atomic_file

POSE_SIZE = 16


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays so that a killed process leaves either the whole file or none."""
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


@contextmanager
def stored_arrays(path: Path) -> Iterator[dict[str, Any]]:
    """The arrays of a file; what they turn out not to hold while a sample is made of them is the file's fault too."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        yield arrays
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise TrainingError(f"{path}: wanted a training sample, got none ({reason}); delete it and prepare again") from error


def camera_arrays(cameras: Sequence[Camera]) -> dict[str, Any]:
    """Cameras as arrays: a row of K, pose, size and depth range each, and their names."""
    rows = [[*each.K.ravel(), *each.world_to_camera.ravel(), *each.size, each.near, each.far] for each in cameras]
    return {"cameras": np.array(rows), "names": np.array([each.name for each in cameras])}


def stored_cameras(arrays: Mapping[str, Any]) -> list[Camera]:
    """The cameras of `camera_arrays`, in their order."""
    return [_camera(str(name), row) for name, row in zip(arrays["names"], arrays["cameras"], strict=True)]


def _camera(name: str, row: Array) -> Camera:
    K, pose, (width, height, near, far) = np.split(row, [9, 9 + POSE_SIZE])
    return Camera(name, K.reshape(3, 3), pose.reshape(4, 4), int(width), int(height), float(near), float(far))
