"""Learned weights: the blending network of the paper in place of geometric ones."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.baselines.method import Map
from ggvs_eval.errors import RenderError
from ggvs_eval.pipelines.one_thread import one_thread
from ggvs_eval.pipelines.online.blend_network import BlendNetwork, BlendOutputs, read_outputs
from ggvs_eval.pipelines.online.blend_weights import load_blend_network, shipped_blend_weights
from ggvs_eval.pipelines.online.blending import BlendingInputs, compose
from ggvs_eval.pipelines.online.network_inputs import BlendMaps, blend_maps, input_channels


@dataclass(frozen=True)
class NetworkBlender:
    """Blends splatted views by a network that sees them, their coverage and the fused geometry (Sec. 3.3, Eqs. 4-5).

    Attributes:
        weights: file of the weights; those that ship for the number of source views unless given.
        tsdf_guidance: which of those that ship: with or without the fused depth among the inputs. A given file knows by itself.
    """

    weights: Path | None = None
    tsdf_guidance: bool = True

    def blend(self, inputs: BlendingInputs) -> Map:
        """The target view of one instant, (H, W, 3).

        Raises:
            WeightsError: no usable weights.
            RenderError: the network is made for another number of source views.
        """
        maps = blend_maps(inputs)
        return blend_by(self._network(len(maps.sources)), maps)

    def _network(self, views: int) -> BlendNetwork:
        if self.weights is None:
            return load_blend_network(shipped_blend_weights(views, self.tsdf_guidance))
        network = load_blend_network(self.weights)
        if network.config.views != views:
            raise RenderError(
                f"{self.weights}: a blending network for {network.config.views} source views, got {views}; "
                "change the protocol's number of sources, or give weights trained for it"
            )
        return network


def blend_by(network: BlendNetwork, maps: BlendMaps) -> Map:
    """The image that a network makes of the views, (H, W, 3); equal bits whatever the number of threads."""
    channels = torch.from_numpy(input_channels(maps, network.config.tsdf_guidance))[None]
    device = next(network.parameters()).device
    with one_thread(), torch.inference_mode():
        outputs = read_outputs(network(channels.to(device, memory_format=torch.channels_last)))
    return compose_maps(outputs, maps)


def compose_maps(outputs: BlendOutputs, maps: BlendMaps) -> Map:
    """Eqs. 4-5 with the outputs of one instant (a batch of one)."""
    weights = _array(outputs.weights[0]) * maps.alphas
    background = np.moveaxis(_array(outputs.background[0]), 0, -1)
    return compose(list(maps.colours), list(weights), background, _array(outputs.background_weight[0]))


def _array(tensor: Tensor) -> Map:
    return np.ascontiguousarray(tensor.cpu().numpy(), dtype=np.float32)
