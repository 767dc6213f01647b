"""From splats and fused depth to a picture, on the device: registration, the blending network, composition and refinement."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.pipelines.online.blend_maps import FAINT
from ggvs_eval.pipelines.online.blend_network import (
    SURE,
    BlendNetwork,
    compose_tensors,
    read_outputs,
    small_outputs,
    weighted_mean_tensor,
)
from ggvs_eval.pipelines.online.device import blend_kernels
from ggvs_eval.pipelines.online.device.launch import launch
from ggvs_eval.pipelines.online.device.order_statistics import masked_median
from ggvs_eval.pipelines.online.device.splats import DeviceSplats
from ggvs_eval.pipelines.online.device.views import DeviceViews, area_cells, between_cells, pixel_map, to_device
from ggvs_eval.pipelines.online.network_inputs import ray_slopes
from ggvs_eval.pipelines.online.refiner import NO_WEIGHT


@dataclass(frozen=True, eq=False)
class DeviceMaps:
    """`BlendMaps` on the device; colours are (K, 3, H, W), weights (K,)."""

    target: Camera
    sources: tuple[Camera, ...]
    colours: Tensor
    coverage: Tensor
    visibilities: Tensor
    alphas: Tensor
    depths: Tensor
    fused_depth: Tensor
    weights: Tensor

    def unseen(self) -> Tensor:
        """Return the share of what the target sees that no view shows, (H, W)."""
        return 1 - self.visibilities.sum(dim=0).clamp(max=1)

    def reduced(self, scale: int) -> "DeviceMaps":
        """The maps of a camera with so many times fewer pixels, see `BlendMaps.reduced`."""
        if scale == 1:
            return self
        size = self.fused_depth.shape
        height, width = (-(-length // scale) for length in size)
        target = replace(self.target, width=width * scale, height=height * scale).resized(width, height)
        top, left = (min(scale // 2, length - 1) for length in size)
        flat = (self.coverage, self.visibilities, self.alphas)
        averaged = _averaged(torch.cat([self.colours, *(maps[:, None] for maps in flat)], dim=1), scale)
        coverage, visibilities, alphas = averaged[:, 3:].unbind(dim=1)
        picked = torch.cat([self.depths, self.fused_depth[None]])[:, top::scale, left::scale]
        depths = _continued(picked[None], height, width)[0]
        colours, weights = averaged[:, :3], self.weights
        return DeviceMaps(target, self.sources, colours, coverage, visibilities, alphas, depths[:-1], depths[-1], weights)


def _continued(maps: Tensor, height: int, width: int) -> Tensor:
    """Maps (B, C, H, W) with their last row and column repeated up to a size."""
    return functional.pad(maps, (0, width - maps.shape[3], 0, height - maps.shape[2]), mode="replicate")


def _averaged(maps: Tensor, scale: int) -> Tensor:
    """Mean of each block of maps (K, C, H, W), their last row and column repeated to whole blocks."""
    height, width = (-(-size // scale) * scale for size in maps.shape[2:])
    return functional.avg_pool2d(_continued(maps, height, width), scale)


def register_views(target: Camera, depth: Tensor, views: DeviceViews, splats: DeviceSplats, tolerance: float) -> DeviceMaps:
    """Register every view by the fused depth, (H, W), as `register_views` of the compiled path.

    Args:
        depth: fused.
        views: the sources; their depths are filtered, their images brought to one colour.
        splats: of the same views.
        tolerance: depths that differ by less are the same surface, world units.
    """
    maps = to_device(np.stack([pixel_map(target, camera) for camera in views.cameras]), depth.device)
    colours = torch.empty((len(views.cameras), 3, *depth.shape), device=depth.device)
    coverage, visibilities = torch.empty_like(splats.alphas), torch.empty_like(splats.alphas)
    inputs = (depth, views.images, views.depths, maps, views.sizes, splats.features, splats.alphas, tolerance, float(FAINT))
    launch(blend_kernels.register_views, splats.alphas.shape, *inputs, colours, coverage, visibilities)
    weights = to_device(view_weights(target, views.cameras, views.shares), depth.device)
    return DeviceMaps(target, views.cameras, colours, coverage, visibilities, splats.alphas, splats.depths, depth, weights)


def network_channels(maps: DeviceMaps, registered: bool, views: int) -> Tensor:
    """Input channels of the network, (channels, H, W), see `input_channels`.

    Args:
        maps: of the network's own size.
        registered: with group 9, ``registered`` guidance; else ``channels``.
        views: how many views the network is made for.
    """
    depth, target, device = maps.fused_depth, maps.target, maps.fused_depth.device
    median = masked_median(depth.reshape(1, -1, 1), (depth > 0).reshape(1, -1, 1))[0, 0]
    unit = torch.where(median > 0, median, target.far)
    to_normal, to_target = (torch.empty_like(maps.depths, memory_format=torch.contiguous_format) for _ in range(2))
    slopes = (to_device(each, device) for each in ray_slopes(target))
    centres = to_device(np.stack([rigid_between(source, target)[:3, 3] for source in maps.sources]), device)
    launch(blend_kernels.geometry_channels, depth.shape, depth.contiguous(), *slopes, target.far, centres, to_normal, to_target)
    distances = to_device([float(np.linalg.norm(source.centre - target.centre)) for source in maps.sources], device) / unit
    axes = to_device([float(source.axis @ target.axis) for source in maps.sources], device)
    size = maps.depths.shape
    groups = [
        maps.colours.flatten(0, 1),
        _inverse(maps.depths, unit),
        maps.alphas,
        to_normal,
        to_target,
        distances[:, None, None].expand(size),
        axes[:, None, None].expand(size),
        *([maps.visibilities] if registered else []),
    ]
    widened = [functional.pad(group, (0, 0, 0, 0, 0, (views - size[0]) * (len(group) // size[0]))) for group in groups]
    widened.insert(3, _inverse(depth, unit)[None])
    return torch.cat(widened)


def _inverse(depth: Tensor, unit: Tensor) -> Tensor:
    return torch.where(depth > 0, unit / depth.clamp(min=1e-30), 0.0)


def push_pull(colours: Tensor, covered: Tensor) -> Tensor:
    """Fill what is not covered, (H, W), of a picture (3, H, W) from ever coarser averages, as the compiled `push_pull`."""
    return _filled(colours.contiguous(), covered.float())


def _filled(colours: Tensor, known: Tensor) -> Tensor:
    height, width = known.shape
    if min(height, width) < 2:
        return colours
    small, device = ((height + 1) // 2, (width + 1) // 2), known.device
    coarse, coarse_known = torch.empty((3, *small), device=device), torch.empty(small, device=device)
    cells = (*area_cells(height, small[0], device), *area_cells(width, small[1], device))
    launch(blend_kernels.average_known, small, colours, known, *cells, coarse, coarse_known)
    between = (*between_cells(height, small[0], device), *between_cells(width, small[1], device))
    out = torch.empty_like(colours)
    whole = (known > 0).all()[None]  # stays on the device: what is not needed is computed, and not looked at
    launch(blend_kernels.fill_unknown, known.shape, colours, known, whole, _filled(coarse, coarse_known), *between, out)
    return out


def blend_views(network: BlendNetwork, maps: DeviceMaps, registered: bool) -> tuple[Tensor, Tensor]:
    """Blend the views by the network: the picture (3, H, W) in [0, 1], and the share of each view, (K, h, w)."""
    config = network.config
    reduced = maps.reduced(config.scale)
    raw = network(network_channels(reduced, registered, config.views)[None])
    colours, coverage = maps.colours[None], maps.coverage[None]
    mean = weighted_mean_tensor(colours, maps.weights[None, :, None, None] * coverage)[0]
    background = push_pull(mean, (maps.alphas > COVERED_ALPHA).any(dim=0))
    start: Mapping[str, Tensor] = {
        "weights": maps.weights[None],
        "unseen": maps.unseen()[None],
        "background": background[None],
    }
    outputs = read_outputs(raw, start, config.views)
    views = {"colours": colours, "coverage": coverage, "fused_depth": maps.fused_depth[None]}
    picture = network.refine(compose_tensors(outputs, colours, coverage), outputs, views)[0].clamp(0, 1)
    return picture, _view_shares(small_outputs(raw, start["weights"], config.views)[0], reduced)


def _view_shares(small: Tensor, reduced: DeviceMaps) -> Tensor:
    """Share of each view in the picture, see `view_shares` of the network blender."""
    weights = small[: len(reduced.sources)] * reduced.coverage
    unseen = reduced.unseen().clamp(SURE, 1 - SURE)
    background = 1 / (1 + torch.exp(-small[len(reduced.sources)]) * (1 - unseen) / unseen)
    return weights * ((1 - background) / weights.sum(dim=0).clamp(min=NO_WEIGHT))
