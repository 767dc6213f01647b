"""Certainty that nothing moves, on the device: the rules of the compiled path's `stillness`."""

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.pipelines.online import stillness as rules
from ggvs_eval.pipelines.online.device import blend_kernels
from ggvs_eval.pipelines.online.device.depth_stages import DeviceChange
from ggvs_eval.pipelines.online.device.launch import launch
from ggvs_eval.pipelines.online.device.order_statistics import masked_median
from ggvs_eval.pipelines.online.device.splats import DeviceSplats
from ggvs_eval.pipelines.online.device.views import DeviceViews, pixel_map, to_device


def stillness(
    target: Camera, depth: Tensor, views: DeviceViews, changes: Sequence[DeviceChange | None], largest: Tensor, tolerance: float
) -> Tensor:
    """Rate how sure it is that nothing moves at each cell, (h, w); of a view that is new `changes` has None."""
    surface = cells(depth)
    known = torch.ones_like(surface, dtype=torch.bool)
    still, apart = torch.ones_like(surface), torch.zeros_like(surface)
    small = rules.middle_rays(target)
    seen = [(views.cameras[k], views.layer(views.depths, k), change) for k, change in enumerate(changes) if change is not None]
    for scale in ("pixels", "colours"):
        maps = [(camera, depths, getattr(change, scale)) for camera, depths, change in seen]
        shared, apart, known = _shared_change(small, surface, maps, tolerance)
        still = still * falling(shared / apart.clamp(min=rules.LEAST_NOISE**2), rules.SHARED) * known
    median = masked_median(apart.reshape(1, -1, 1), known.reshape(1, -1, 1))[0, 0]
    return still * falling(largest / median.sqrt().clamp(rules.LEAST_NOISE, rules.MOST_NOISE), rules.LARGEST)


def _shared_change(
    target: Camera, depth: Tensor, views: Sequence[tuple[Camera, Tensor, Tensor]], tolerance: float
) -> tuple[Tensor, Tensor, Tensor]:
    """See `shared_change`; each view is a camera, its depth and its change of colour, (Hs, Ws, 3)."""
    colour = torch.zeros((3, *depth.shape), device=depth.device)
    visibility = torch.empty_like(depth)
    total, (energy, looks, own) = torch.zeros_like(colour), torch.zeros((3, *depth.shape), device=depth.device)
    for camera, own_depth, change in views:
        size = change.shape[:2]
        to_source = to_device(pixel_map(target, camera.resized(size[1], size[0])), depth.device)
        there = cells(own_depth, size).contiguous()
        launch(
            blend_kernels.warp_change, depth.shape, depth, change.contiguous(), there, to_source, tolerance, colour, visibility
        )
        weighted = visibility * (colour - light(colour, visibility))
        total = total + weighted
        energy = energy + mean_square(weighted)
        looks, own = looks + visibility, own + visibility**2
    sums = torch.stack([mean_square(total) - energy, looks**2 - own, energy, own])
    products, pairs, energy, own = pooled(sums)
    shared = products / pairs.clamp(min=float(rules.NEVER))
    return shared, energy / own.clamp(min=float(rules.NEVER)) - shared, pairs > 2 * rules.LEAST_LOOKS


def splatted_change(splats: DeviceSplats, changes: Sequence[DeviceChange | None], beta_mask: float, lambda_t: float) -> Tensor:
    """The largest change of colour that a source sees at each cell and next to it, (h, w), of those that are not new."""
    masks, alphas = cells(splats.features[..., 3]), cells(splats.alphas)
    covering = torch.zeros_like(masks[0])
    for k, change in enumerate(changes):
        if change is not None:
            covering = torch.maximum(covering, torch.where(alphas[k] >= COVERED_ALPHA, masks[k], 0.0))
    widest = functional.max_pool2d(covering[None, None], 2 * rules.REACH + 1, 1, rules.REACH)[0, 0]
    return (widest - beta_mask).clamp(min=0) * lambda_t


def cells(image: Tensor, size: Sequence[int] | None = None) -> Tensor:
    """The pixel in the middle of each cell of maps (..., H, W), see `ggvs_eval.pipelines.online.stillness.cells`."""
    sides = image.shape[-2:]
    counts = size or tuple(-(-side // rules.REDUCTION) for side in sides)
    rows, columns = (_middles(side, count, image.device) for side, count in zip(sides, counts, strict=True))
    return image.index_select(-2, rows).index_select(-1, columns)


@lru_cache(maxsize=64)
def _middles(side: int, count: int, device: torch.device) -> Tensor:
    return to_device(rules.middles(side, count), device)


def light(change: Tensor, weight: Tensor) -> Tensor:
    """Mean of a change of colour per cell, (3, h, w), over areas as wide as light, by weights (h, w)."""
    down, across = (_widened(size, weight.device) for size in weight.shape)
    sums = down @ torch.cat([change * weight, weight[None]]) @ across.T
    return enlarged(sums[:3] / (sums[3:] + 1e-3), weight.shape)


def enlarged(maps: Tensor, size: Sequence[int]) -> Tensor:
    """Maps (n, h, w) at a larger size, bilinearly."""
    return functional.interpolate(maps[None], size=tuple(size), mode="bilinear", align_corners=False)[0]


@lru_cache(maxsize=16)
def _widened(size: int, device: torch.device) -> Tensor:
    """Matrix that averages a line of cells over wide areas: what `light` of the compiled path makes by cv2's resize and blur."""
    small = -(-size // (rules.LIGHT_PX // rules.REDUCTION))
    lines: Array = np.eye(size, dtype=np.float64)
    averaged = cv2.resize(lines, (size, small), interpolation=cv2.INTER_AREA)
    return to_device(cv2.GaussianBlur(averaged, (1, 9), sigmaX=1, sigmaY=1), device)


def mean_square(change: Tensor) -> Tensor:
    """Energy of a change of colour, (3, h, w), per channel."""
    return (change**2).sum(dim=0) / 3


def pooled(maps: Tensor) -> Tensor:
    """Means of maps (n, h, w) over the window of the changes of views, as OpenCV blurs float32."""
    down, across = (_pooling(size, maps.device) for size in maps.shape[1:])
    return down @ maps @ across.T


@lru_cache(maxsize=16)
def _pooling(size: int, device: torch.device) -> Tensor:
    """Matrix that blurs a line of cells."""
    lines: Array = np.eye(size, dtype=np.float64)
    taps = round(8 * rules.POOL + 1) | 1
    return to_device(cv2.GaussianBlur(lines, (1, taps), sigmaX=rules.POOL, sigmaY=rules.POOL), device)


def falling(value: Tensor, limits: tuple[float, float]) -> Tensor:
    """1 up to the first limit, 0 from the last one on, a line between them."""
    first, last = limits
    return ((last - value) / (last - first)).clamp(0, 1)
