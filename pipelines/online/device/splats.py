"""Forward rendering of all views on the device: Gaussians sorted by depth, then by tile, then blended pixel by pixel."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Array32
from ggvs_eval.camera import Camera
from ggvs_eval.pipelines.online.device import splat_kernels
from ggvs_eval.pipelines.online.device.launch import exclusive_sum, launch, sort_pairs
from ggvs_eval.pipelines.online.device.views import DeviceViews, pixel_map, to_device

DEPTH_BITS = 31  # of a positive float


@dataclass(frozen=True, eq=False)
class DeviceSplats:
    """The K views in the target view.

    Attributes:
        features: colours in [0, 1] and difference mask, (K, H, W, 4), float32.
        alphas: coverage, (K, H, W).
        depths: z in the target camera, (K, H, W), world units.
        pairs: how many pairs of a Gaussian and a tile there are, (1,), int32; pairs beyond the capacity are lost.
    """

    features: Tensor
    alphas: Tensor
    depths: Tensor
    pairs: Tensor


def splat_views(
    target: Camera, views: DeviceViews, depths: Tensor, masks: Tensor, *, near: float, scale: float, capacity: int
) -> DeviceSplats:
    """Splat every view by itself, colours and mask, as `splat` of the compiled path does.

    Args:
        views: their images.
        depths: where the Gaussians are, (K, H, W).
        masks: a fourth feature, (K, H, W).
        near: as in `splat`.
        scale: as in `splat`.
        capacity: pairs of a Gaussian and a tile that there is room for, at least one; see `DeviceSplats.pairs`.

    Reading:
        Two stable sorts of 32 bits, by depth and then by tile, order the pairs as the compiled splat does, equal depths in
        reading order; sorting pairs at once by 64 bits would move twice the bytes. How many pairs there are is known on the
        device alone: room is kept for a number of them, and whoever reads the picture sees whether it was enough.
    """
    device, count, size = depths.device, depths.numel(), (target.height, target.width)
    projectors = to_device(np.stack([_projector(camera, target, near, scale) for camera in views.cameras]), device)
    keys, ids = (torch.empty(2 * count, dtype=torch.int32, device=device) for _ in range(2))
    launch(splat_kernels.order_keys, depths.shape, depths, projectors, keys, ids)
    sort_pairs(keys, ids, count, DEPTH_BITS)

    counts, starts = (torch.empty(count, dtype=torch.int32, device=device) for _ in range(2))
    ranges, ellipses = torch.empty((count, 4), dtype=torch.int32, device=device), torch.empty((count, 6), device=device)
    launch(splat_kernels.count_tiles, count, depths, projectors, keys, ids, counts, ranges, ellipses)
    exclusive_sum(counts, starts)

    across, down = (-(-length // splat_kernels.TILE) for length in target.size)
    tiles = across * down
    listed, numbers = _tile_lists((counts, starts, ranges, ids), depths[0].numel(), across, tiles, len(views.cameras), capacity)
    begins, ends = (torch.zeros(len(views.cameras) * tiles, dtype=torch.int32, device=device) for _ in range(2))
    launch(splat_kernels.find_ends, capacity, listed, capacity, begins, ends)

    features = torch.empty((len(views.cameras), *size, 4), device=device)
    alphas, z = (torch.empty((len(views.cameras), *size), device=device) for _ in range(2))
    threads = (len(views.cameras), tiles, splat_kernels.TILE**2)
    inputs = (begins, ends, numbers, ellipses, views.images, masks, across, tiles)
    launch(splat_kernels.blend_tiles, threads, *inputs, features, alphas, z)
    return DeviceSplats(features, alphas, z, starts[-1:] + counts[-1:])


def _tile_lists(
    gaussians: tuple[Tensor, Tensor, Tensor, Tensor], pixels: int, across: int, tiles: int, views: int, capacity: int
) -> tuple[Tensor, Tensor]:
    """Tiles, ascending, and in each the numbers of its Gaussians, front to back; unused places at the end."""
    counts, starts, ranges, ids = gaussians
    keys = torch.full((2 * capacity,), views * tiles, dtype=torch.int32, device=counts.device)
    numbers = torch.zeros(2 * capacity, dtype=torch.int32, device=counts.device)
    launch(splat_kernels.list_pairs, len(counts), counts, starts, ranges, ids, pixels, across, tiles, capacity, keys, numbers)
    sort_pairs(keys, numbers, capacity, (views * tiles).bit_length())
    return keys, numbers


def _projector(camera: Camera, target: Camera, near: float, scale: float) -> Array32:
    """Parameters by which one source's Gaussians become ellipses in the target image, (22,); see `kernels/splat.hpp`."""
    fx, fy, cx, cy = target.K[0, 0], target.K[1, 1], target.K[0, 2], target.K[1, 2]
    slopes = 1.3 * target.width / (2.0 * fx), 1.3 * target.height / (2.0 * fy)
    sigma = scale / (0.5 * (camera.K[0, 0] + camera.K[1, 1]))
    last = target.width - 1, target.height - 1
    values = (sigma, fx, fy, cx - 0.5, cy - 0.5, *slopes, near, *last)
    return np.concatenate([pixel_map(camera, target, to_pixels=False), np.array(values)]).astype(np.float32)
