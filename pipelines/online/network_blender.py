"""Learned weights: the blending network of the paper in place of geometric ones."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.baselines.method import Map
from ggvs_eval.errors import RenderError
from ggvs_eval.one_thread import one_thread
from ggvs_eval.pipelines.online.blend_maps import BlendMaps, Guidance, blend_maps
from ggvs_eval.pipelines.online.blend_network import BlendNetwork, BlendOutputs, read_outputs
from ggvs_eval.pipelines.online.blend_weights import load_blend_network, shipped_blend_weights
from ggvs_eval.pipelines.online.blending import BlendingInputs, compose, weighted_mean
from ggvs_eval.pipelines.online.inpainting import push_pull
from ggvs_eval.pipelines.online.network_inputs import COVERED_ALPHA, input_channels


@dataclass(frozen=True)
class NetworkBlender:
    """Blends views by a network that sees them, their coverage and the fused geometry (Sec. 3.3, Eqs. 4-5).

    Attributes:
        weights: file of the weights; those that ship unless given.
        guidance: which of those that ship, see `BlendConfig`. A given file knows by itself.
    """

    weights: Path | None = None
    guidance: Guidance = "registered"

    def blend(self, inputs: BlendingInputs) -> Map:
        """The target view of one instant, (H, W, 3).

        Raises:
            WeightsError: no usable weights.
            RenderError: more source views than the network is made for.
        """
        path = self.weights or shipped_blend_weights(self.guidance)
        network, views = load_blend_network(path), len(inputs.instant.sources)
        if views > network.config.views:
            raise RenderError(
                f"{path.name}: a blending network for at most {network.config.views} source views, got {views}; "
                "change the protocol's number of sources, or train one for more (ggvs-eval train blend --views)"
            )
        return blend_by(network, blend_maps(inputs, network.config.guidance))


def blend_by(network: BlendNetwork, maps: BlendMaps) -> Map:
    """The image that a network makes of the views, (H, W, 3); equal bits whatever the number of threads."""
    config, start = network.config, blend_start(maps)
    small = maps.reduced(config.scale)
    channels = torch.from_numpy(input_channels(small, config.guidance, config.views))[None]
    device = next(network.parameters()).device
    with one_thread(), torch.inference_mode():
        raw = network(channels.to(device, memory_format=torch.channels_last)).cpu()
        outputs = read_outputs(raw, {name: torch.from_numpy(array)[None] for name, array in start.items()}, config.views)
        return refined(network, compose_maps(outputs, maps), outputs, maps)


def blend_start(maps: BlendMaps) -> dict[str, Map]:
    """What a network starts from: distance-based weights, and the blended views with their holes filled, see `read_outputs`."""
    near = maps.near_weights()
    blended = weighted_mean(list(maps.colours), [weight * view for weight, view in zip(near, maps.coverage, strict=True)])
    filled = push_pull(blended, maps.alphas.max(axis=0) > COVERED_ALPHA)
    return {"near": near, "unseen": maps.unseen(), "background": np.ascontiguousarray(np.moveaxis(filled, 2, 0))}


def compose_maps(outputs: BlendOutputs, maps: BlendMaps) -> Map:
    """Eqs. 4-5 with the outputs of one instant (a batch of one)."""
    weights = _array(outputs.weights[0]) * maps.coverage
    background = np.moveaxis(_array(outputs.background[0]), 0, -1)
    return compose(list(maps.colours), list(weights), background, _array(outputs.background_weight[0]))


def refined(network: BlendNetwork, picture: Map, outputs: BlendOutputs, maps: BlendMaps) -> Map:
    """What the network's refiner makes of a composed picture, (H, W, 3), in [0, 1]."""
    views = {
        "colours": torch.from_numpy(maps.colours)[None].permute(0, 1, 4, 2, 3),
        "coverage": torch.from_numpy(maps.coverage)[None],
        "fused_depth": torch.from_numpy(maps.fused_depth)[None],
    }
    image = network.refine(torch.from_numpy(picture)[None].permute(0, 3, 1, 2), outputs, views)[0]
    return np.ascontiguousarray(image.clamp(0, 1).permute(1, 2, 0).numpy())


def _array(tensor: Tensor) -> Map:
    return np.ascontiguousarray(tensor.numpy(), dtype=np.float32)
