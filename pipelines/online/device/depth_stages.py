"""Depth on the device: the temporal filter, the fused depth of the ray march, and what settles it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.contested_depth import LEAST_ALPHA, LEAST_SHARE, RATIO, comparable
from ggvs_eval.geometry.difference_mask import REDUCTION
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.tsdf import march_end
from ggvs_eval.pipelines.online.device import blend_kernels, filter_kernels, march_kernels
from ggvs_eval.pipelines.online.device.launch import launch
from ggvs_eval.pipelines.online.device.splats import DeviceSplats
from ggvs_eval.pipelines.online.device.views import DeviceViews, area_cells, pixel_map, to_device


@dataclass(frozen=True, eq=False)
class DeviceChange:
    """Change in a view since the instant before, see `ggvs_eval.pipelines.online.depth_filter.Change`."""

    before: Tensor
    now: Tensor
    colours: Tensor
    mask: Tensor

    @property
    def pixels(self) -> Tensor:
        """Change of each pixel, (H, W, 3), float32 in [-1, 1]."""
        return (self.now.float() - self.before.float()) / 255


def change_between(now: Tensor, before: Tensor, *, lambda_t: float, beta: float, mean: bool = False) -> DeviceChange:
    """Change between two images (H, W, 3), uint8, and the weight of new depth against its history (Eq. 1)."""
    height, width = now.shape[:2]
    cells = max(height // REDUCTION, 1), max(width // REDUCTION, 1)
    colours = torch.empty((*cells, 3), device=now.device)
    rows, columns = area_cells(height, cells[0], now.device), area_cells(width, cells[1], now.device)
    launch(filter_kernels.colour_change, cells, now, before, *rows, *columns, colours)
    difference = colours.abs().mean(dim=-1) if mean else colours.abs().amax(dim=-1)
    widest = functional.max_pool2d((difference / lambda_t + beta).clamp(max=1)[None, None], 3, 1, 1)
    mask = functional.interpolate(widest, size=(height, width), mode="bilinear", align_corners=False)[0, 0]
    return DeviceChange(before, now, colours, mask)


def filter_depth(depth: Tensor, history: Tensor, mask: Tensor, tolerance: float) -> Tensor:
    """Mix new depth with its history (Eq. 2), all (H, W), as `filter_depth` of the compiled path."""
    mixed = torch.empty_like(depth, memory_format=torch.contiguous_format)
    launch(filter_kernels.mix_depth, depth.shape, depth, history, mask, tolerance, mixed)
    return mixed


def fusion_weights(depth: Tensor, tau: float, depth_noise: float) -> Tensor:
    """Weigh depth pixels by trust (Eqs. 11-12), (H, W)."""
    weights = torch.empty_like(depth, memory_format=torch.contiguous_format)
    launch(filter_kernels.fusion_weights, depth.shape, depth, tau, 7 * depth_noise, weights)
    return weights


History = Mapping[str, tuple[int, Tensor, Tensor]]  # of a camera: instant, image, filtered depth


@dataclass(frozen=True)
class MaskOptions:
    """Constants of the masks and of the filter, see `OnlineOptions`."""

    lambda_t: float
    beta: float
    tolerance: float
    enabled: bool
    mean: bool


def filter_views(
    index: int, views: DeviceViews, history: History, options: MaskOptions
) -> tuple[Tensor, Tensor, list[DeviceChange | None], History]:
    """Filter the depth of every view of an instant.

    Returns:
        Filtered depths and masks, (K, H, W), what changed in each view, None where it cannot be known, and the history for the
        next instant; that of cameras that are no sources now stays.
    """
    filtered, masks, kept = views.depths.clone(), torch.ones_like(views.depths), dict(history)
    changes: list[DeviceChange | None] = [None] * len(views.cameras)
    for k, camera in enumerate(views.cameras):
        image, depth = views.layer(views.images, k), views.layer(filtered, k)
        before = history.get(camera.name)
        if options.enabled and before is not None and before[0] == index - 1 and before[1].shape == image.shape:
            change = change_between(image, before[1], lambda_t=options.lambda_t, beta=options.beta, mean=options.mean)
            views.layer(masks, k).copy_(change.mask)
            depth.copy_(filter_depth(views.layer(views.depths, k), before[2], change.mask, options.tolerance))
            changes[k] = change
        kept[camera.name] = (index, image, depth)
    return filtered, masks, changes, kept


@dataclass(frozen=True, eq=False)
class DeviceMarch:
    """Fused depth (H, W) of a target, world units, and the sum of the weights behind it (H, W)."""

    target: Camera
    depth: Tensor
    weight: Tensor


@dataclass(frozen=True, eq=False)
class PastDepth:
    """The march of the instant before, the gain of each ray of the present target (H, W), and the largest weight."""

    march: DeviceMarch
    gain: Tensor
    limit: float


@dataclass(frozen=True)
class MarchOptions:
    """Steps of the march, see `ray_march`."""

    tau: float
    min_step: float = 0.1
    step_fraction: float = 0.8
    skip_empty: bool = True


def ray_march(
    target: Camera, views: DeviceViews, depths: Tensor, weights: Tensor, options: MarchOptions, past: PastDepth | None = None
) -> DeviceMarch:
    """Find the first surface of the fused field along each ray, as `ray_march` of the compiled path (Eqs. 3, 9, 10, 13, 14)."""
    size, device = (target.height, target.width), depths.device
    constants = _field(target, options, [views.layer(depths, k) for k in range(len(views.cameras))])
    cameras = views.cameras if past is None else (*views.cameras, past.march.target)
    layers = [(views.layer(depths, k), views.layer(weights, k)) for k in range(len(views.cameras))]
    if past is None:
        nothing = torch.zeros((1, 1), device=device)
        held = nothing, nothing, torch.full(size, -1.0, device=device), 0.0
    else:
        layers.append((past.march.depth, past.march.weight))
        held = past.march.depth, past.march.weight, past.gain, past.limit
    nexts = (
        _occupancy(target, cameras, layers, constants, device) if options.skip_empty else torch.zeros((1, 1, 1), device=device)
    )
    maps = to_device(np.stack([pixel_map(target, camera) for camera in cameras]), device)
    depth, weight = torch.empty(size, device=device), torch.empty(size, device=device)
    launch(march_kernels.march_rays, size, constants, depths, weights, maps, views.sizes, *held, nexts, depth, weight)
    return DeviceMarch(target, depth, weight)


def _field(target: Camera, options: MarchOptions, depths: Sequence[Tensor]) -> march_kernels.Field:
    constants = march_kernels.Field()
    end = march_end(target, options.tau, options.min_step, depths)
    constants.near, constants.far, constants.tau = target.near, end, options.tau
    constants.step_fraction, constants.min_step = options.step_fraction, options.min_step
    constants.skip_empty = options.skip_empty
    first, last = (int(np.float32(depth).view(np.int32)) for depth in (target.near, end))
    constants.first_bits, constants.per_bit = first, march_kernels.SLABS / (last - first)
    constants.width, constants.height = target.width, target.height
    return constants


def _occupancy(
    target: Camera,
    cameras: tuple[Camera, ...],
    layers: list[tuple[Tensor, Tensor]],
    constants: march_kernels.Field,
    device: torch.device,
) -> Tensor:
    """Depth of the next slab that any view may influence, for every column and slab of the target's frustum."""
    columns = -(-target.height // march_kernels.COLUMN), -(-target.width // march_kernels.COLUMN)
    marks = torch.zeros((*columns, march_kernels.SLABS), dtype=torch.uint8, device=device)
    for camera, (depth, weight) in zip(cameras, layers, strict=True):
        blocks = [-(-size // march_kernels.BLOCK) for size in depth.shape]
        to_target = to_device(pixel_map(camera, target), device)
        launch(march_kernels.mark_shells, blocks, depth, weight, to_target, constants, marks)
    nexts = torch.empty(marks.shape, device=device)
    launch(march_kernels.find_next, columns, marks, constants, nexts)
    return nexts


def settle_depth(target: Camera, fused: Tensor, views: DeviceViews, splats: DeviceSplats, tolerance: float) -> Tensor:
    """Fused depth, replaced where most views and the colours of all speak for a splat's, as `settle_depth`."""
    if not comparable(views.cameras):
        return fused
    maps = to_device(np.stack([pixel_map(target, camera) for camera in views.cameras]), fused.device)
    weights = to_device(view_weights(target, views.cameras, views.shares), fused.device)
    settled = torch.empty_like(fused)
    seen = (fused, views.images, maps, views.sizes, splats.alphas, splats.depths, weights)
    launch(blend_kernels.settle_depth, fused.shape, *seen, tolerance, LEAST_ALPHA, LEAST_SHARE, RATIO, settled)
    return settled
