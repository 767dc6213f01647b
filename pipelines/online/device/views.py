"""Source views as stacks on the device, and cameras in the form that the kernels take."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.method import SourceView


@dataclass(frozen=True, eq=False)
class DeviceViews:
    """The K source views of an instant on the device; of a smaller view the first rows and columns of its layer count.

    Attributes:
        cameras: of the views.
        shares: see `SourceView.share`.
        images: (K, H, W, 3), uint8.
        depths: (K, H, W), float32, 0 where unknown.
        sizes: width and height of each, (K, 2), int32.
    """

    cameras: tuple[Camera, ...]
    shares: tuple[float, ...]
    images: Tensor
    depths: Tensor
    sizes: Tensor

    def layer(self, stack: Tensor, k: int) -> Tensor:
        """The part of a stack that a view fills."""
        camera = self.cameras[k]
        return stack[k, : camera.height, : camera.width]


def upload(sources: Sequence[SourceView], device: torch.device) -> DeviceViews:
    """Copy views to the device, each byte once."""
    cameras = tuple(source.camera for source in sources)
    height, width = max(camera.height for camera in cameras), max(camera.width for camera in cameras)
    images = torch.zeros((len(cameras), height, width, 3), dtype=torch.uint8, device=device)
    depths = torch.zeros((len(cameras), height, width), dtype=torch.float32, device=device)
    views = DeviceViews(
        cameras, tuple(source.share for source in sources), images, depths, to_device([camera.size for camera in cameras], device)
    )
    for k, source in enumerate(sources):
        views.layer(images, k).copy_(torch.from_numpy(np.ascontiguousarray(source.image)), non_blocking=True)
        depth = source.depth  # an array, or where it was computed
        there = depth if isinstance(depth, Tensor) else torch.from_numpy(np.ascontiguousarray(depth, np.float32))
        views.layer(depths, k).copy_(there, non_blocking=True)
    return views


def to_device(values: Any, device: torch.device, double: bool = False) -> Tensor:
    """Numbers on the device: whole ones int32, others float32 or `double`; the host does not wait for what the device does."""
    array = np.asarray(values)
    kind = np.int32 if array.dtype.kind in "iu" else np.float64 if double else np.float32
    return torch.from_numpy(array.astype(kind)).to(device, non_blocking=True)


def pixel_map(first: Camera, second: Camera, to_pixels: bool = True) -> Array32:
    """Matrix and offset, (12,), that take (depth u, depth v, depth) of one camera to another, see `kernels/camera.hpp`.

    Args:
        first: whose pixels and depths are given.
        second: where they are wanted.
        to_pixels: (u z, v z, z) in its image; else the point in its frame.
    """
    to_image = np.eye(3)
    if to_pixels:
        to_image[[0, 1, 0, 1], [0, 1, 2, 2]] = second.K[[0, 1, 0, 1], [0, 1, 2, 2]]
    turned: Array = to_image @ rigid_between(first, second)[:3]
    fx, fy, cx, cy = first.K[0, 0], first.K[1, 1], first.K[0, 2], first.K[1, 2]
    last = turned[:, 2] - turned[:, 0] * cx / fx - turned[:, 1] * cy / fy
    matrix = np.stack([turned[:, 0] / fx, turned[:, 1] / fy, last], axis=1)
    return np.concatenate([matrix.ravel(), turned[:, 3]]).astype(np.float32)


@lru_cache(maxsize=64)
def area_cells(size: int, cells: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Cut a line of pixels into equal cells: their first and last pixel, (cells, 2), and the shares of these, (cells, n)."""
    length = size / cells
    begins = np.arange(cells) * length
    ends = np.minimum((np.arange(cells) + 1) * length, size)
    # Overlaps below a millionth of a pixel are the rounding of begin and end.
    first, last = (begins + 1e-6).astype(int), np.minimum(np.ceil(ends - 1e-6).astype(int), size)
    pixels = first[:, None] + np.arange((last - first).max())
    overlaps = np.minimum(pixels + 1.0, ends[:, None]) - np.maximum(pixels, begins[:, None])
    shares = np.where(pixels < last[:, None], overlaps / length, 0)
    return to_device(np.stack([first, last], axis=1), device), to_device(shares, device)


@lru_cache(maxsize=64)
def between_cells(fine: int, coarse: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Places of fine pixels between coarse ones: the two neighbours, (fine, 2), and the share of the second, (fine,)."""
    at = np.clip((np.arange(fine) + 0.5) * coarse / fine - 0.5, 0.0, coarse - 1.0)
    first = at.astype(int)
    pairs: NDArray[np.int64] = np.stack([first, np.minimum(first + 1, coarse - 1)], axis=1)
    return to_device(pairs, device), to_device(at - first, device)
