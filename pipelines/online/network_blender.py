"""Learned weights: the blending network of the paper in place of geometric ones."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ggvs_eval.arrays import Map
from ggvs_eval.compute_device import compute_device
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import weighted_mean
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.kernels.side_by_side import side_by_side
from ggvs_eval.one_thread import one_thread
from ggvs_eval.pipelines.online.blend_maps import BlendMaps, Guidance, blend_maps
from ggvs_eval.pipelines.online.blend_network import BlendNetwork, small_outputs
from ggvs_eval.pipelines.online.blend_weights import load_blend_network, shipped_blend_weights
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs
from ggvs_eval.pipelines.online.full_size import composed, refined
from ggvs_eval.pipelines.online.inpainting import push_pull
from ggvs_eval.pipelines.online.input_kernel import network_channels
from ggvs_eval.pipelines.online.network_inputs import GUIDED
from ggvs_eval.pipelines.online.overview import overview
from ggvs_eval.pipelines.online.torch_blender import blend_on
from ggvs_eval.pipelines.online.unet_kernel import unet_outputs
from ggvs_eval.pipelines.online.view_shares import view_shares


@dataclass(frozen=True)
class NetworkBlender:
    """Blends views by a network that sees them, their coverage and the fused geometry (Sec. 3.3, Eqs. 4-5).

    Attributes:
        weights: file of the weights; those that ship unless given.
        guidance: which of those that ship, see `BlendNetworkOptions`. A given file knows by itself.
        device: where the network computes, see `compute_device`.
    """

    weights: Path | None = None
    guidance: Guidance = "registered"
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse a device that is not there."""
        compute_device(self.device)

    def blend(self, inputs: BlendingInputs) -> Blended:
        """The target view of one instant.

        Raises:
            DeviceError: the GPU's memory is out.
            WeightsError: no usable weights.
            RenderError: more source views than the network is made for.
        """
        path, device = self.weights or shipped_blend_weights(self.guidance), compute_device(self.device)
        network, views = load_blend_network(path, device), len(inputs.instant.sources)
        if views > network.config.views:
            raise RenderError(
                f"{path.name}: a blending network for at most {network.config.views} source views, got {views}; "
                "change the protocol's number of sources, or train one for more (ggvs-eval train blend --views)"
            )
        maps = blend_maps(inputs, network.config.guidance)
        return blend_by(network, maps) if device.type == "cpu" else blend_on(network, maps, device)


def blend_by(network: BlendNetwork, maps: BlendMaps) -> Blended:
    """What a network makes of the views; equal bits whatever the number of threads.

    Compiled kernels compute it, those of `unet_kernel` at the network's own size and those of `full_size` at full size.
    """
    config = network.config
    seen = overview(maps, config.scale)
    (small, weights), background = side_by_side(
        lambda: _small_outputs(network, seen.small), lambda: push_pull(seen.picture, seen.covered)
    )
    picture = composed(maps, seen.unseen, background, small, config.scale)
    if network.refiner is None:
        return Blended(picture.image(), weights)
    depth = maps.fused_depth if config.guidance in GUIDED else None
    return Blended(refined(network.refiner, picture, depth, small, config.scale, len(maps.sources)), weights)


def _small_outputs(network: BlendNetwork, reduced: BlendMaps) -> tuple[Map, Map]:
    """`small_outputs` of the network for one instant, (K + 4 + F, h, w), and the share of each view by them, (K, h, w)."""
    config = network.config
    raw = unet_outputs(network.unet, network_channels(reduced, config.guidance, config.views))
    with one_thread(), torch.inference_mode():
        start = torch.from_numpy(reduced.weights)[None]
        small = small_outputs(torch.from_numpy(raw)[None], start, config.views)[0].contiguous().numpy()
    return small, view_shares(small, reduced)


def blend_start(maps: BlendMaps) -> dict[str, Map]:
    """What a network starts from: geometric weights, and the blended views with their holes filled, see `read_outputs`."""
    background = np.ascontiguousarray(np.moveaxis(filled_picture(maps), 2, 0))
    return {"weights": maps.weights, "unseen": maps.unseen(), "background": background}


def filled_picture(maps: BlendMaps) -> Map:
    """The views blended by coverage and their weights, what none covers filled from its surroundings, (H, W, 3)."""
    blended = weighted_mean(list(maps.colours), list(maps.coverage), maps.weights.tolist())
    return push_pull(blended, maps.alphas.max(axis=0) > COVERED_ALPHA)
