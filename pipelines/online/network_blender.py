"""Learned weights: the blending network of the paper in place of geometric ones."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.compute_device import compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import weighted_mean
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads, side_by_side
from ggvs_eval.pipelines.online.blend_maps import BlendMaps, Guidance, blend_maps
from ggvs_eval.pipelines.online.blend_network import SURE, BlendNetwork, compose_tensors, read_outputs, small_outputs
from ggvs_eval.pipelines.online.blend_weights import load_blend_network, shipped_blend_weights
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs, push_pull
from ggvs_eval.pipelines.online.full_size import Overview, composed, overview, refined, registered
from ggvs_eval.pipelines.online.network_inputs import GUIDED, network_channels, present_channels
from ggvs_eval.pipelines.online.refiner import NO_WEIGHT
from ggvs_eval.pipelines.online.unet import unet_outputs


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
    return np.asarray(weights * ((1 - background) / np.maximum(weights.sum(axis=0), NO_WEIGHT)), np.float32)


def blend_on(network: BlendNetwork, maps: BlendMaps, device: torch.device) -> Blended:
    """Blend the views by a network on a device, as `blend_by` does but for rounding.

    What the network looks at, and the background, come from the compiled kernels on the CPU: they pass over the views once.

    Args:
        network: lies on the device.
        maps: the K views.
        device: where network, composition and refiner compute.

    Raises:
        DeviceError: the GPU's memory is out.
    """
    config = network.config
    summary = overview(maps, config.scale)
    channels = network_channels(summary.small, config.guidance, config.views)
    with rendering_on(device):
        raw = network(torch.as_tensor(channels)[None])
        background = push_pull(
            summary.picture, summary.covered, out=summary.picture
        )  # while a GPU works on what it was asked for
        start = _tensors({"weights": maps.weights, "unseen": summary.unseen, "background": np.moveaxis(background, 2, 0)})
        views = _tensors({"coverage": maps.coverage, "fused_depth": maps.fused_depth})
        views["colours"] = torch.as_tensor(maps.colours)[None].permute(0, 1, 4, 2, 3)  # (1, K, 3, H, W)
        outputs = read_outputs(raw, start, config.views)
        picture = network.refine(compose_tensors(outputs, views["colours"], views["coverage"]), outputs, views)
        image = picture[0].clamp(0, 1).permute(1, 2, 0).contiguous().numpy(force=True)
        small = small_outputs(raw, start["weights"], config.views)[0].contiguous().numpy(force=True)
    return Blended(image, view_shares(small, summary.small))


def _tensors(arrays: Mapping[str, Map]) -> dict[str, Tensor]:
    """Arrays as batches of one."""
    return {name: torch.as_tensor(np.ascontiguousarray(array))[None] for name, array in arrays.items()}


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
        inputs = without_blind(inputs)
        path, device = self.weights or shipped_blend_weights(self.guidance), compute_device(self.device)
        network, views = load_blend_network(path, device), len(inputs.instant.sources)
        if views > network.config.views:
            raise RenderError(
                f"{path.name}: a blending network for at most {network.config.views} source views, got {views}; "
                "change the protocol's number of sources, or train one for more (ggvs-eval train blend --views)"
            )
        guidance = network.config.guidance
        if device.type != "cpu":
            return blend_on(network, blend_maps(inputs, guidance), device)
        if guidance == "registered":
            return blend_by(network, *registered(inputs, network.config.scale))
        return blend_by(network, blend_maps(inputs, guidance))


def without_blind(inputs: BlendingInputs) -> BlendingInputs:
    """The inputs without the views that cover no pixel of the target, unless none does: what is blind takes no view's place."""
    kept = [k for k, splat in enumerate(inputs.splats) if splat.alpha.max(initial=0) >= COVERED_ALPHA]
    if not 0 < len(kept) < len(inputs.splats):
        return inputs
    instant = replace(inputs.instant, sources=tuple(inputs.instant.sources[k] for k in kept))
    return replace(inputs, instant=instant, splats=[inputs.splats[k] for k in kept])


def blend_by(network: BlendNetwork, maps: BlendMaps, summary: Overview | None = None) -> Blended:
    """Blend the views by a network; equal bits whatever the number of threads.

    Compiled kernels compute it, those of `unet` at the network's own size and those of `full_size` at full size.

    Args:
        network: its weights.
        maps: the K views.
        summary: their `overview`, if it is known.
    """
    config = network.config
    summary = summary or overview(maps, config.scale)
    (small, weights), background = side_by_side(
        lambda: _small_outputs(network, summary.small),
        lambda: push_pull(summary.picture, summary.covered, out=summary.picture),
    )
    picture = composed(maps, summary.unseen, background, small, config.scale)
    if network.refiner is None:
        return Blended(picture.image(), weights)
    depth = maps.fused_depth if config.guidance in GUIDED else None
    return Blended(refined(network.refiner, picture, depth, small, config.scale, len(maps.sources)), weights)


def _small_outputs(network: BlendNetwork, reduced: BlendMaps) -> tuple[Map, Map]:
    """`small_outputs` of the network for one instant, (K + 4 + F, h, w), and `view_shares` by them, (K, h, w)."""
    from ggvs_eval.kernels import _core

    config = network.config
    views = len(reduced.sources)
    channels = network_channels(reduced, config.guidance, views)
    raw = unet_outputs(network.unet, channels, present_channels(views, config.views, config.guidance))
    logarithms = np.log(np.maximum(reduced.weights, np.float32(NO_WEIGHT)))
    coverage, seen = (np.ascontiguousarray(each, np.float32) for each in (reduced.coverage, reduced.visibilities))
    level = SIMD_LEVELS.index(get_simd_level())
    return _core.read_outputs(raw, logarithms, coverage, seen, config.views, SURE, get_threads(), level)


def blend_start(maps: BlendMaps) -> dict[str, Map]:
    """Return what a network starts from: geometric weights, and the blended views with holes filled, see `read_outputs`."""
    background = np.ascontiguousarray(np.moveaxis(filled_picture(maps), 2, 0))
    return {"weights": maps.weights, "unseen": maps.unseen(), "background": background}


def filled_picture(maps: BlendMaps) -> Map:
    """The views blended by coverage and their weights, what none covers filled from its surroundings, (H, W, 3)."""
    blended = weighted_mean(list(maps.colours), list(maps.coverage), maps.weights.tolist())
    return push_pull(blended, np.max(maps.alphas, axis=0) > COVERED_ALPHA)
