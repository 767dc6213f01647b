"""Learned weights: the blending network of the paper in place of geometric ones."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ggvs_eval.baselines.method import Map
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import weighted_mean
from ggvs_eval.kernels.side_by_side import side_by_side
from ggvs_eval.one_thread import one_thread
from ggvs_eval.pipelines.online.blend_maps import BlendMaps, Guidance, blend_maps
from ggvs_eval.pipelines.online.blend_network import SURE, BlendNetwork, small_outputs
from ggvs_eval.pipelines.online.blend_weights import load_blend_network, shipped_blend_weights
from ggvs_eval.pipelines.online.blending import COVERED_ALPHA, Blended, BlendingInputs
from ggvs_eval.pipelines.online.full_size import composed, refined
from ggvs_eval.pipelines.online.inpainting import push_pull
from ggvs_eval.pipelines.online.input_kernel import network_channels
from ggvs_eval.pipelines.online.network_inputs import GUIDED
from ggvs_eval.pipelines.online.overview import overview
from ggvs_eval.pipelines.online.unet_kernel import unet_outputs


@dataclass(frozen=True)
class NetworkBlender:
    """Blends views by a network that sees them, their coverage and the fused geometry (Sec. 3.3, Eqs. 4-5).

    Attributes:
        weights: file of the weights; those that ship unless given.
        guidance: which of those that ship, see `BlendConfig`. A given file knows by itself.
    """

    weights: Path | None = None
    guidance: Guidance = "registered"

    def blend(self, inputs: BlendingInputs) -> Blended:
        """The target view of one instant.

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


def blend_by(network: BlendNetwork, maps: BlendMaps) -> Blended:
    """What a network makes of the views; equal bits whatever the number of threads.

    Compiled kernels compute it, those of `unet_kernel` at the network's own size and those of `full_size` at full size.
    """
    config, near = network.config, maps.near_weights()
    seen = overview(maps, near, config.scale)
    (small, weights), background = side_by_side(
        lambda: _small_outputs(network, seen.small, near), lambda: push_pull(seen.picture, seen.covered)
    )
    picture = composed(maps, seen.unseen, background, small, config.scale)
    if network.refiner is None:
        return Blended(picture.image(), weights)
    depth = maps.fused_depth if config.guidance in GUIDED else None
    return Blended(refined(network.refiner, picture, depth, small, config.scale, len(near)), weights)


def _small_outputs(network: BlendNetwork, reduced: BlendMaps, near: Map) -> tuple[Map, Map]:
    """`small_outputs` of the network for one instant, (K + 4 + F, h, w), and the share of each view by them, (K, h, w)."""
    config = network.config
    raw = unet_outputs(network.unet, network_channels(reduced, config.guidance, config.views))
    with one_thread(), torch.inference_mode():
        small = small_outputs(torch.from_numpy(raw)[None], torch.from_numpy(near)[None], config.views)[0].contiguous().numpy()
    return small, view_shares(small, reduced)


def view_shares(small: Map, reduced: BlendMaps) -> Map:
    """Share of each view in the composed picture (Eqs. 4-5) at the network's own size, (K, h, w).

    Args:
        small: `small_outputs` of the network, (K + 4 + F, h, w).
        reduced: the maps of that size.
    """
    views = len(reduced.coverage)
    weights = small[:views] * reduced.coverage
    unseen = np.clip(reduced.unseen(), SURE, 1 - SURE)
    background = 1 / (1 + np.exp(-small[views]) * (1 - unseen) / unseen)
    return np.asarray(weights * ((1 - background) / (weights.sum(axis=0) + 1e-6)), np.float32)


def blend_start(maps: BlendMaps) -> dict[str, Map]:
    """What a network starts from: distance-based weights, and the blended views with their holes filled, see `read_outputs`."""
    near = maps.near_weights()
    background = np.ascontiguousarray(np.moveaxis(filled_picture(maps, near), 2, 0))
    return {"near": near, "unseen": maps.unseen(), "background": background}


def filled_picture(maps: BlendMaps, near: Map) -> Map:
    """The views blended by coverage and distance, what none covers filled from its surroundings, (H, W, 3)."""
    blended = weighted_mean(list(maps.colours), list(maps.coverage), near.tolist())
    return push_pull(blended, maps.alphas.max(axis=0) > COVERED_ALPHA)
