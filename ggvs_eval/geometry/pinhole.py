"""Cameras and images in the form that the compiled kernels take."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.errors import GgvsError, RenderError
from ggvs_eval.kernels.portable import product, transformed

MOST_PIXELS = 65535  # a side of an image, see kernels/camera_arguments.hpp
Pinhole = tuple[float, float, float, float, int, int]


def pinhole(camera: Camera) -> Pinhole:
    """(fx, fy, cx, cy, width, height) of a camera.

    Raises:
        RenderError: more pixels a side than the kernels count.
    """
    if max(camera.size) > MOST_PIXELS:
        raise RenderError(
            f"camera {camera.name}: wanted at most {MOST_PIXELS} pixels a side, got {camera.width} "
            f"x {camera.height}; make it smaller (Camera.resized)"
        )
    K = camera.K
    return (
        float(K[0, 0]),
        float(K[1, 1]),
        float(K[0, 2]),
        float(K[1, 2]),
        camera.width,
        camera.height,
    )


def rigid_between(first: Camera, second: Camera) -> NDArray[np.float64]:
    """Rigid transform from the first camera's frame to the second's, (4, 4).

    Float64, as the world's origin may be far away.
    """
    transform = np.eye(4)
    transform[:3, :3] = product(second.rotation, first.rotation.T)
    transform[:3, 3] = second.translation - transformed(transform[:3, :3], first.translation)
    return transform


def as_image(
    array: NDArray, camera: Camera, name: str, error: type[GgvsError]
) -> NDArray[np.float32]:
    """Return the array as C-contiguous float32 if its height and width are the camera's.

    Copies only what is not so already.

    Raises:
        GgvsError: the given kind of it; the array has another size than the camera.
    """
    if array.shape[:2] != (camera.height, camera.width):
        raise error(
            f"camera {camera.name}: {name} must be {camera.height} x {camera.width} like the "
            f"camera, got {array.shape}; resize one of them (Camera.resized)"
        )
    return np.ascontiguousarray(array, dtype=np.float32)


def as_image8(array: ArrayLike | None, camera: Camera, error: type[GgvsError]) -> Image8:
    """Return the array itself if it is an image of the camera, RGB uint8 (H, W, 3).

    Raises:
        GgvsError: the given kind of it; the message says what to do about what came.
    """
    shape = camera.height, camera.width, 3
    if array is None:
        raise error(
            f"camera {camera.name}: wanted a uint8 image of {shape}, got none; give one of every "
            f"camera"
        )
    image = np.asarray(array)
    if image.shape != shape or image.dtype != np.uint8:
        raise error(
            f"camera {camera.name}: wanted a uint8 image of {shape}, got {image.dtype} "
            f"{image.shape}; {_mend(image, shape)}"
        )
    return image


def _mend(image: NDArray, shape: tuple[int, int, int]) -> str:
    """State how to make an image of that shape of what was given."""
    if image.shape == (shape[2], *shape[:2]):
        return "channels come last: np.moveaxis(image, 0, -1)"
    if image.shape == (*shape[:2], 4):
        return (
            "leave the fourth channel out, red first: image[..., :3] of RGBA, image[..., 2::-1] of "
            "BGRA"
        )
    if image.shape in (shape[:2], (*shape[:2], 1)):
        return "repeat grey for red, green and blue"
    if image.shape != shape:
        return "resize all images of the rig, or build it of `camera.resized`"
    if np.issubdtype(image.dtype, np.floating):
        return (
            "scale colours to 0..255 and round them, from [0, 1] by np.rint(255 * "
            "image).astype(np.uint8)"
        )
    return "scale colours to 0..255, from 16 bits by (image // 257).astype(np.uint8)"
