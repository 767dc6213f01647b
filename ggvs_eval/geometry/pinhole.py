"""Cameras and images in the form that the compiled kernels take."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import GgvsError
from ggvs_eval.kernels.portable import product, transformed

Pinhole = tuple[float, float, float, float, int, int]


def pinhole(camera: Camera) -> Pinhole:
    """(fx, fy, cx, cy, width, height) of a camera."""
    K = camera.K
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), camera.width, camera.height


def rigid_between(first: Camera, second: Camera) -> NDArray[np.float64]:
    """Rigid transform from the first camera's frame to the second's, (4, 4); float64, as the world's origin may be far away."""
    transform = np.eye(4)
    transform[:3, :3] = product(second.rotation, first.rotation.T)
    transform[:3, 3] = second.translation - transformed(transform[:3, :3], first.translation)
    return transform


def as_image(array: NDArray, camera: Camera, what: str, error: type[GgvsError]) -> NDArray[np.float32]:
    """The array as C-contiguous float32 if its height and width are the camera's; copies only what is not so already.

    Raises:
        GgvsError: the given kind of it; the array has another size than the camera.
    """
    if array.shape[:2] != (camera.height, camera.width):
        raise error(
            f"camera {camera.name}: {what} must be {camera.height} x {camera.width} like the camera, got {array.shape}; "
            "resize one of them (Camera.resized)"
        )
    return np.ascontiguousarray(array, dtype=np.float32)
