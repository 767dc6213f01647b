"""LLFF pose files (``poses_bounds.npy``): N x 17 numbers, in axes of their own."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.datasets.array_file import map_array
from ggvs_eval.datasets.assemble import check_rig_size
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.kernels.portable import transformed

# What is beyond is damage, and no square of it is finite.
LARGEST_NUMBER = 1e100


class LlffPose(NamedTuple):
    """One row of a pose file, in OpenCV axes.

    Attributes:
        world_to_camera: rigid transform, (4, 4).
        hwf: height, width and focal length in pixels of the images the poses were made for.
        near: smallest depth of the scene, world units.
        far: largest depth of the scene, world units.
    """

    world_to_camera: Array
    hwf: tuple[float, float, float]
    near: float
    far: float


def read_llff_poses(path: Path) -> list[LlffPose]:
    """Read a pose file.

    Args:
        path: ``poses_bounds.npy``. A row holds a 3 x 5 matrix [r0 r1 r2 | t | hwf] with the camera's axes in the world in the
            order down, right, backwards, its centre t, and then near and far.

    Raises:
        CaptureError: absent, no plain array of numbers, not N x 17, or a row that is not finite.
    """
    rows = _load_rows(path)
    spoilt = np.flatnonzero(~(np.abs(rows) < LARGEST_NUMBER).all(axis=1))
    if spoilt.size:
        listed = ", ".join(map(str, spoilt))
        raise CaptureError(f"{path}: wanted finite numbers, got NaN or infinity in row {listed} (from 0); calibrate again")
    return [_from_row(row) for row in rows]


def write_llff_poses(path: Path, poses: Sequence[LlffPose]) -> None:
    """Write a pose file that `read_llff_poses` reads back; it appears under its name when it is whole."""
    rows = np.stack([_to_row(pose) for pose in poses])  # (N, 17)
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.save(file, rows)


def llff_pose(camera: Camera) -> LlffPose:
    """The row of a camera; its principal point is taken to be the image centre and its focal length the mean of both."""
    return LlffPose(camera.world_to_camera, (camera.height, camera.width, camera.focal_px), camera.near, camera.far)


def llff_camera(pose: LlffPose, name: str, path: Path) -> Camera:
    """The camera of a row, at the size the poses were made for; `path` is the file named in errors."""
    height, width, focal_px = pose.hwf
    K = np.array([[focal_px, 0.0, width / 2], [0.0, focal_px, height / 2], [0.0, 0.0, 1.0]])
    try:
        return Camera(name, K, pose.world_to_camera, round(width), round(height), pose.near, pose.far)
    except CameraError as error:
        raise CaptureError(f"{path}: {error}") from error


def _load_rows(path: Path) -> Array:
    try:
        rows = map_array(path)
    except ValueError as error:
        raise CaptureError(
            f"{path}: wanted an N x 17 array of numbers saved by numpy.save, got: {error}; write it again"
        ) from error
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind not in "fiu":
        form = f"{rows.shape} {rows.dtype}"
        raise CaptureError(f"{path}: wanted an N x 17 array of numbers (LLFF), got {form}; write 15 pose numbers, near and far")
    check_rig_size(path, len(rows))
    return rows.astype(np.float64)


def _from_row(row: Array) -> LlffPose:
    down, right, backwards, centre, hwf = row[:15].reshape(3, 5).T
    rotation = np.stack([right, down, -backwards])  # (3, 3), rows are the camera's axes in the world
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation
    world_to_camera[:3, 3] = transformed(-rotation, centre)
    return LlffPose(world_to_camera, (float(hwf[0]), float(hwf[1]), float(hwf[2])), float(row[15]), float(row[16]))


def _to_row(pose: LlffPose) -> Array:
    right, down, forwards = pose.world_to_camera[:3, :3]
    centre = transformed(-pose.world_to_camera[:3, :3].T, pose.world_to_camera[:3, 3])
    matrix = np.stack([down, right, -forwards, centre, np.asarray(pose.hwf)], axis=1)  # (3, 5)
    return np.concatenate([matrix.ravel(), [pose.near, pose.far]])
