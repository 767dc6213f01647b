"""First half of the step on the device, up to what a blender is given: filtered depth, gains, splats, and the fused depth."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.method import Instant
from ggvs_eval.pipelines.online.device import depth_stages
from ggvs_eval.pipelines.online.device.depth_stages import (
    DeviceChange,
    DeviceMarch,
    History,
    MarchOptions,
    MaskOptions,
    PastDepth,
)
from ggvs_eval.pipelines.online.device.exposure import Exposure, ExposureState, compensate, estimate_exposure
from ggvs_eval.pipelines.online.device.splats import DeviceSplats, splat_views
from ggvs_eval.pipelines.online.device.views import DeviceViews
from ggvs_eval.pipelines.online.exposure_compensation import MEMORY
from ggvs_eval.pipelines.online.geometry_guided import SAME_SURFACE_TAU, OnlineOptions

PAIRS_PER_GAUSSIAN = 2.0  # that there is room for at first
ROOM = 1.25  # times what was needed when it was not enough

Mark = Callable[[str, str], None]  # called when a part of a stage begins


class PairRoom:
    """Room for the pairs of a Gaussian and a tile; how many there are is known when the device is done, and not before.

    Attributes:
        per_gaussian: pairs that there is room for.
    """

    def __init__(self) -> None:
        self.per_gaussian = PAIRS_PER_GAUSSIAN

    def capacity(self, views: DeviceViews) -> int:
        """Pairs that there is room for, of all views."""
        return int(self.per_gaussian * views.depths.numel()) + 1

    def sufficed(self, views: DeviceViews, pairs: Tensor) -> bool:
        """Wait for the device, tell whether all pairs found room, and make more of it where they did not: render again then."""
        needed = int(pairs)
        if needed <= self.capacity(views):
            return True
        self.per_gaussian = ROOM * needed / views.depths.numel()
        return False


@dataclass(frozen=True, eq=False)
class GeometryState:
    """State of depth and gains that one instant leaves for the next."""

    index: int = -2
    history: History = field(default_factory=dict)
    exposure: ExposureState | None = None
    march: DeviceMarch | None = None


@dataclass(frozen=True, eq=False)
class DeviceInputs:
    """`BlendingInputs` on the device.

    Attributes:
        views: the sources, their depth filtered, their images brought to one colour.
        splats: of the same views.
        changes: in each of them since the instant before; None where it was not there.
        depth: fused and settled, (H, W), world units, 0 where unknown.
        tau: truncation distance of the fusion, world units.
        exposure: of the sources; None where it is not compensated.
        state: for the next instant.
    """

    views: DeviceViews
    splats: DeviceSplats
    changes: Sequence[DeviceChange | None]
    depth: Tensor
    tau: float
    exposure: Exposure | None
    state: GeometryState


def blending_inputs(
    instant: Instant, views: DeviceViews, options: OnlineOptions, before: GeometryState, capacity: int, mark: Mark
) -> DeviceInputs:
    """Filter, compensate, splat and fuse the views of an instant; nothing is read back.

    Args:
        instant: its target, number and unit; the sources are `views`.
        views: as uploaded.
        options: constants of the method.
        before: left by the instant before.
        capacity: see `splat_views`.
        mark: called when a stage begins.
    """
    target, index, units = instant.target, instant.index, instant.units_per_metre
    tau = options.tau_m * units
    mark("filter", "masks and filter")
    masked = MaskOptions(
        options.lambda_t, options.beta_mask, options.history_tolerance, options.temporal, options.mask_channels == "mean"
    )
    depths, masks, changes, history = depth_stages.filter_views(index, views, before.history, masked)
    filtered, exposure, gains = replace(views, depths=depths), None, before.exposure
    if options.compensated:
        mark("filter", "exposure")
        memory = MEMORY if options.temporal else 1
        exposure, gains = estimate_exposure(index, target, filtered, depths, tau, gains, memory)
        filtered = replace(filtered, images=compensate(filtered, exposure))
    mark("filter", "fusion weights")
    weights = torch.zeros_like(depths)
    for k in range(len(views.cameras)):
        layer = views.layer(depths, k)
        views.layer(weights, k).copy_(depth_stages.fusion_weights(layer, tau, options.depth_noise_m * units))
    mark("splat", "splat")
    splatted = depths if options.splatted_depth == "filtered" else views.depths
    near, scale = instant.near_plane, options.gaussian_scale_px
    splats = splat_views(target, filtered, splatted, masks, near=near, scale=scale, capacity=capacity)
    mark("tsdf", "occupancy and march")
    past = _past_depth(index, splats, changes, before, options)
    march = depth_stages.ray_march(target, filtered, depths, weights, MarchOptions(tau, options.min_step), past)
    surface = march.depth
    mark("tsdf", "contested depth")
    if options.settled:
        surface = depth_stages.settle_depth(target, surface, filtered, splats, SAME_SURFACE_TAU * tau)
    return DeviceInputs(filtered, splats, changes, surface, tau, exposure, GeometryState(index, history, gains, march))


def _past_depth(
    index: int,
    splats: DeviceSplats,
    changes: Sequence[DeviceChange | None],
    before: GeometryState,
    options: OnlineOptions,
) -> PastDepth | None:
    """The fused depth of the instant before, trusted where nothing moves (Eqs. 13-14)."""
    if not options.temporal or before.march is None or before.index != index - 1:
        return None
    mask = torch.full_like(splats.alphas[0], -1.0)
    for k, change in enumerate(changes):
        if change is not None:
            mask = torch.maximum(mask, torch.where(splats.alphas[k] >= COVERED_ALPHA, splats.features[k, ..., 3], -1.0))
    gain = (1 - torch.where(mask < 0, 1.0, mask)).clamp(min=0) * options.beta_temporal
    return PastDepth(before.march, gain, options.eta)
