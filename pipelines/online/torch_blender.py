"""The blending network on a GPU: what `blend_by` computes by compiled kernels, by the torch code that training differentiates."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.compute_device import rendering_on
from ggvs_eval.pipelines.online.blend_maps import BlendMaps
from ggvs_eval.pipelines.online.blend_network import BlendNetwork, compose_tensors, read_outputs, small_outputs
from ggvs_eval.pipelines.online.blending import Blended
from ggvs_eval.pipelines.online.inpainting import push_pull
from ggvs_eval.pipelines.online.input_kernel import network_channels
from ggvs_eval.pipelines.online.overview import overview
from ggvs_eval.pipelines.online.view_shares import view_shares


def blend_on(network: BlendNetwork, maps: BlendMaps, device: torch.device) -> Blended:
    """What a network makes of the views, as `blend_by` but for rounding.

    What the network looks at, and the background, come from the compiled kernels on the CPU: they pass over the views once.

    Args:
        network: lies on the device.
        maps: the K views.
        device: where network, composition and refiner compute.

    Raises:
        DeviceError: the GPU's memory is out.
    """
    config = network.config
    seen = overview(maps, config.scale)
    channels = network_channels(seen.small, config.guidance, config.views)
    with rendering_on(device):
        raw = network(torch.as_tensor(channels)[None])
        background = push_pull(seen.picture, seen.covered)  # while a GPU works on what it was asked for
        start = _tensors({"weights": maps.weights, "unseen": seen.unseen, "background": np.moveaxis(background, 2, 0)})
        views = _tensors({"coverage": maps.coverage, "fused_depth": maps.fused_depth})
        views["colours"] = torch.as_tensor(maps.colours)[None].permute(0, 1, 4, 2, 3)  # (1, K, 3, H, W)
        outputs = read_outputs(raw, start, config.views)
        picture = network.refine(compose_tensors(outputs, views["colours"], views["coverage"]), outputs, views)
        image = picture[0].clamp(0, 1).permute(1, 2, 0).contiguous().numpy(force=True)
        small = small_outputs(raw, start["weights"], config.views)[0].contiguous().numpy(force=True)
    return Blended(image, view_shares(small, seen.small))


def _tensors(arrays: Mapping[str, Map]) -> dict[str, Tensor]:
    """Arrays as batches of one."""
    return {name: torch.as_tensor(np.ascontiguousarray(array))[None] for name, array in arrays.items()}
