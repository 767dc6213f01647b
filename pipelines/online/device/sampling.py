"""Parts of training samples, on the device: views splatted and warped, and what geometric weights make of them."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import rendering_on
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.method import Instant
from ggvs_eval.pipelines.online.blend_network import weighted_mean_tensor
from ggvs_eval.pipelines.online.device import blend_kernels
from ggvs_eval.pipelines.online.device.geometry import DeviceInputs, GeometryState, PairRoom, blending_inputs
from ggvs_eval.pipelines.online.device.launch import launch, on_stream_of
from ggvs_eval.pipelines.online.device.picture import push_pull
from ggvs_eval.pipelines.online.device.views import DeviceViews, pixel_map, to_device, upload
from ggvs_eval.pipelines.online.geometry_guided import OnlineOptions


def sampled_maps(instant: Instant, options: OnlineOptions, device: torch.device) -> dict[str, Map]:
    """Compute the maps of one instant that a training sample holds, and the geometric blender's picture.

    Args:
        instant: its sources have the order of the maps.
        options: constants of the method; what would need an instant before is left out.
        device: a GPU, or the CPU for tests.

    Returns:
        By the names of a training sample, all float32: ``splats`` and ``warps``, (K, H, W, 3), ``alphas``, ``depths`` and
        ``visibilities``, (K, H, W), ``fused_depth``, (H, W); ``geometric``: the picture of `GeometricBlender`, (H, W, 3).

    Raises:
        DeviceError: the GPU's memory is out.

    Reading:
        On a CPU all but the colours of warps and of the picture have the bits of the compiled path; those differ by up to 1e-6,
        since images are taken in 8 bit here, and in [0, 1] by `warp`.
    """
    room = PairRoom()
    with rendering_on(device), on_stream_of(device):
        views = upload(instant.sources, device)
        while True:
            inputs = blending_inputs(instant, views, options, GeometryState(), room.capacity(views), lambda stage, part: None)
            maps = {name: each.contiguous().numpy(force=True) for name, each in _maps(instant.target, inputs).items()}
            if room.sufficed(views, inputs.splats.pairs):
                return maps


def _maps(target: Camera, inputs: DeviceInputs) -> Mapping[str, Tensor]:
    """See `sampled_maps`; still on the device."""
    warps, visibilities = warp_views(target, inputs.depth, inputs.views, inputs.tau)
    return {
        "splats": inputs.splats.features[..., :3],
        "alphas": inputs.splats.alphas,
        "depths": inputs.splats.depths,
        "warps": warps.permute(0, 2, 3, 1),
        "visibilities": visibilities,
        "fused_depth": inputs.depth,
        "geometric": blend_geometrically(target, inputs, warps, visibilities).permute(1, 2, 0),
    }


def warp_views(target: Camera, depth: Tensor, views: DeviceViews, tolerance: float) -> tuple[Tensor, Tensor]:
    """Sample every view where the target's surface projects into it, as `warp` of the compiled path, bicubically.

    Args:
        depth: its depth, (H, W), world units, 0 where unknown.
        views: the sources.
        tolerance: depths that differ by less are the same surface, world units.

    Returns:
        Colours, (K, 3, H, W), 0 outside the images, and visibilities, (K, H, W).
    """
    maps = to_device(np.stack([pixel_map(target, camera) for camera in views.cameras]), depth.device)
    colours = torch.empty((len(views.cameras), 3, *depth.shape), device=depth.device)
    visibilities = torch.empty((len(views.cameras), *depth.shape), device=depth.device)
    inputs = (depth, views.images, views.depths, maps, views.sizes, tolerance)
    launch(blend_kernels.warp_views, visibilities.shape, *inputs, colours, visibilities)
    return colours, visibilities


def blend_geometrically(target: Camera, inputs: DeviceInputs, warps: Tensor, visibilities: Tensor) -> Tensor:
    """Blend warped views by visibility and parallax over the splats' mean, (3, H, W), as `GeometricBlender` does."""
    views, splats = inputs.views, inputs.splats
    weights = to_device(view_weights(target, views.cameras, views.shares), inputs.depth.device)[:, None, None]
    splatted = splats.features[..., :3].permute(0, 3, 1, 2)
    mean = weighted_mean_tensor(splatted[None], (weights * splats.alphas)[None])[0]
    background = push_pull(mean, (splats.alphas > COVERED_ALPHA).any(dim=0))
    surface = weighted_mean_tensor(warps[None], (weights * visibilities)[None])[0]
    return surface + (1 - visibilities.sum(dim=0).clamp(max=1)) * (background - surface)
