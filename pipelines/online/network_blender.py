"""Learned weights: the blending network of the paper in place of geometric ones.

Full-size passes around it run by compiled kernels: all views at one glance, composition,
refinement.

The torch code of `blend_network` and `refiner` says the same, is what training differentiates, and
defines these in the tests.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.compute_device import compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import view_weights, weighted_mean
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.geometry.warp import registration_arguments
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads, side_by_side
from ggvs_eval.pipelines.online.blend_network import (
    BEYOND_VIEWS,
    SURE,
    BlendNetwork,
    compose_tensors,
    load_blend_network,
    packed_once,
    parameter_map,
    read_outputs,
    shipped_blend_weights,
    small_outputs,
    unet_outputs,
)
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs, push_pull
from ggvs_eval.pipelines.online.network_inputs import (
    FAINT,
    GUIDED,
    BlendMaps,
    Guidance,
    blend_maps,
    in_order,
    maps_of,
    network_channels,
    present_channels,
)
from ggvs_eval.pipelines.online.refiner import (
    COLOUR_GAIN,
    LEAST,
    NO_WEIGHT,
    ROW_STEP_PX,
    STATISTICS_GAIN,
    STATISTICS_GRID,
    TYPICAL,
    Refiner,
)

OUTPUT_MULTIPLE = 8  # outputs of a layer that are summed at once


@dataclass(frozen=True, eq=False)
class Overview:
    """The views at one glance.

    Attributes:
        small: `BlendMaps.reduced`.
        unseen: `BlendMaps.unseen`, (H, W), in [0, 1].
        picture: the views blended by coverage and their weights, black where none has any, (H, W,
            3).
        covered: where a splat shows something, (H, W).
    """

    small: BlendMaps
    unseen: Map
    picture: Map
    covered: NDArray[np.bool_]


def overview(maps: BlendMaps, scale: int) -> Overview:
    """Return the inputs that depend on the views alone.

    Args:
        maps: the K views.
        scale: of the network, see `BlendNetworkShape`.
    """
    from ggvs_eval.kernels import _core

    arrays = (maps.colours, maps.coverage, maps.visibilities)
    colours, coverage, visibilities = (np.ascontiguousarray(array, np.float32) for array in arrays)
    alphas = [np.ascontiguousarray(array, np.float32) for array in maps.alphas]
    outputs = _core.overview(
        colours,
        coverage,
        visibilities,
        alphas,
        _depths(maps),
        *_overview_settings(maps.weights, scale),
    )
    return _overview(maps, scale, *outputs)


def registered(inputs: BlendingInputs, scale: int) -> tuple[BlendMaps, Overview]:
    """`blend_maps` with registered views, and their `overview`, in one pass: while the views are in
    the cache.
    """
    from ggvs_eval.kernels import _core

    target, (sources, splats) = inputs.instant.target, in_order(inputs)
    registration = registration_arguments(
        target, inputs.depth, sources, splats, inputs.tau, inputs.forgiven_px
    )
    weights = view_weights(
        target, [source.camera for source in sources], [source.share for source in sources]
    )
    depths = [
        np.ascontiguousarray(array, np.float32)
        for array in (*(view.depth for view in splats), inputs.depth)
    ]
    arguments = (*registration, float(FAINT), depths, *_overview_settings(weights, scale))
    stacks, outputs = _core.register_and_overview(*arguments)
    maps = maps_of(inputs, stacks)
    return maps, _overview(maps, scale, *outputs)


def _depths(maps: BlendMaps) -> list[Map]:
    return [np.ascontiguousarray(array, np.float32) for array in (*maps.depths, maps.fused_depth)]


def _overview_settings(weights: Map, scale: int) -> tuple[Map, int, float, int, int]:
    return weights, scale, COVERED_ALPHA, get_threads(), SIMD_LEVELS.index(get_simd_level())


def _overview(
    maps: BlendMaps,
    scale: int,
    picture: Map,
    unseen: Map,
    covered: NDArray[np.bool_],
    means: Sequence[Map],
    depths: Map,
) -> Overview:
    return Overview(
        small=maps.with_means(scale, means, depths), unseen=unseen, picture=picture, covered=covered
    )


@dataclass(frozen=True, eq=False)
class Composed:
    """The composed picture and how sure it is.

    Attributes:
        picture: (3, H, W), float32.
        spread: standard deviation of the views, (H, W).
        coverage: sum of the views' coverages, (H, W).
    """

    picture: Map
    spread: Map
    coverage: Map

    def image(self) -> Map:
        """Return the picture, (H, W, 3), in [0, 1]."""
        return np.ascontiguousarray(np.moveaxis(self.picture, 0, -1).clip(0, 1))


def composed(maps: BlendMaps, unseen: Map, background: Map, small: Map, scale: int) -> Composed:
    """The views by the network's weights, over the background (Eqs. 4-5): `read_outputs` and
    `compose_tensors` in one pass.

    Args:
        maps: the K views.
        unseen: how little of what the target sees is shown, (H, W).
        background: the picture filled from its surroundings, (H, W, 3).
        small: `small_outputs` of the network, (K + 4 + F, h, w).
        scale: factor by which they are smaller per side.
    """
    from ggvs_eval.kernels import _core

    views = (
        np.ascontiguousarray(maps.colours, np.float32),
        np.ascontiguousarray(maps.coverage, np.float32),
    )
    level = SIMD_LEVELS.index(get_simd_level())
    return Composed(
        *_core.compose(*views, unseen, background, small, scale, SURE, get_threads(), level)
    )


def refined(
    refiner: Refiner, picture: Composed, depth: Map | None, small: Map, scale: int, views: int
) -> Map:
    """Refine the picture, (H, W, 3), in [0, 1]: `evidence` and `Refiner.forward` tile by tile.

    Args:
        picture: what the network's outputs compose.
        depth: fused depth, (H, W), 0 where unknown; None if the network must not see it.
        small: as in `composed`.
        scale: as in `composed`.
        views: K.
    """
    from ggvs_eval.kernels import _core

    depth = (
        np.zeros_like(picture.spread) if depth is None else np.ascontiguousarray(depth, np.float32)
    )
    layers = _conditioned(packed_once(refiner, None, lambda: _layers(refiner)), refiner, picture)
    evidence = picture.picture, picture.spread, picture.coverage, depth
    return _core.refine(
        *evidence,
        small,
        scale,
        views + BEYOND_VIEWS,
        layers,
        get_threads(),
        SIMD_LEVELS.index(get_simd_level()),
    )


def _conditioned(
    layers: list[tuple[Map, Map, int]], refiner: Refiner, picture: Composed
) -> list[tuple[Map, Map, int]]:
    """Return the layers as the statistics of a picture change them: shifted biases, scaled inputs
    of the last one.

    Weights of half precision times statistics of few bits are exact in doubles, sums too: equal
    bits on every processor.
    """
    weights, bias = (
        parameter_map(refiner.condition, name).astype(np.float64) for name in ("weight", "bias")
    )
    *shifts, gain = np.split(
        ((weights * statistics_of(picture)).sum(axis=1) + bias).astype(np.float32), 3
    )
    shifted = [
        (filters, bias + np.pad(shift, (0, len(bias) - len(shift))), count)
        for (filters, bias, count), shift in zip(layers[:-1], shifts, strict=True)
    ]
    taps, *remainder = layers[-1]
    return [*shifted, (taps * (1 + gain)[:, None], *remainder)]


def statistics_of(picture: Composed) -> NDArray[np.float64]:
    """`picture_statistics` by numpy, (4,), with equal bits: torch's threads, once woken, would spin
    next to those of the kernels.

    Args:
        picture: what the network's outputs compose.
    """
    spread, detail = side_by_side(
        lambda: _log_means(np.clip(np.float32(COLOUR_GAIN) * picture.spread[::ROW_STEP_PX], -1, 1)),
        lambda: _log_means(_detail(picture.picture)),
    )
    return (
        np.round(STATISTICS_GAIN * (np.array([*spread, *detail]) - TYPICAL) * STATISTICS_GRID)
        / STATISTICS_GRID
    )


def _detail(picture: Map) -> Map:
    """Return the absolute second differences of the mean colour, of every eighth row.

    0 in a picture that has none.
    """
    parts = slice(1, -1, ROW_STEP_PX), slice(0, -2, ROW_STEP_PX), slice(2, None, ROW_STEP_PX)
    red, green, blue = picture
    rows, above, below = ((red[part] + green[part] + blue[part]) / np.float32(3) for part in parts)
    detail = np.abs(rows - (above + below) / 2)[:, 1:-1] + np.abs(
        rows[:, 1:-1] - (rows[:, :-2] + rows[:, 2:]) / 2
    )
    return detail if detail.size else np.zeros(1, np.float32)


def _log_means(values: Map) -> list[float]:
    """Return the logarithms of the geometric and of the arithmetic mean."""
    wide = values.astype(np.float64)
    return [float(np.log(wide + LEAST).mean()), float(np.log(wide.mean() + LEAST))]


def _layers(refiner: Refiner) -> list[tuple[Map, Map, int]]:
    """Packed filters, bias and number of outputs of each layer.

    Of the last one weights (inputs, outputs filled up).
    """
    from ggvs_eval.kernels import _core

    looks = [(parameter_map(look, "weight"), parameter_map(look, "bias")) for look in refiner.looks]
    weights, bias = (
        parameter_map(refiner.taps, "weight")[:, :, 0, 0],
        parameter_map(refiner.taps, "bias"),
    )
    missing = -len(bias) % OUTPUT_MULTIPLE
    taps = (
        np.ascontiguousarray(np.pad(weights.T, [(0, 0), (0, missing)])),
        np.pad(bias, (0, missing)),
        len(bias),
    )
    return [*((*_core.pack_filters(*look), len(look[1])) for look in looks), taps]


def view_shares(small: Map, reduced: BlendMaps) -> Map:
    """Return the share of each view in the composed picture (Eqs. 4-5) at the network's own size,
    (K, h, w).

    Args:
        small: `small_outputs` of the network, (K + 4 + F, h, w).
        reduced: the maps of that size.
    """
    views = len(reduced.coverage)
    weights = small[:views] * reduced.coverage
    unseen = np.clip(reduced.unseen(), SURE, 1 - SURE)
    background = 1 / (1 + np.exp(-small[views]) * (1 - unseen) / unseen)
    return np.asarray(
        weights * ((1 - background) / np.maximum(weights.sum(axis=0), NO_WEIGHT)), np.float32
    )


def blend_on(network: BlendNetwork, maps: BlendMaps, device: torch.device) -> Blended:
    """Blend the views by a network on a device, as `blend_by` does except for rounding.

    What the network looks at, and the background, come from the compiled kernels on the CPU: they
    pass over the views once.

    Args:
        network: is on the device.
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
        start = _tensors(
            {
                "weights": maps.weights,
                "unseen": summary.unseen,
                "background": np.moveaxis(background, 2, 0),
            }
        )
        views = _tensors({"coverage": maps.coverage, "fused_depth": maps.fused_depth})
        # (1, K, 3, H, W)
        views["colours"] = torch.as_tensor(maps.colours)[None].permute(0, 1, 4, 2, 3)
        outputs = read_outputs(raw, start, config.views)
        picture = network.refine(
            compose_tensors(outputs, views["colours"], views["coverage"]), outputs, views
        )
        image = picture[0].clamp(0, 1).permute(1, 2, 0).contiguous().numpy(force=True)
        small = small_outputs(raw, start["weights"], config.views)[0].contiguous().numpy(force=True)
    return Blended(image, view_shares(small, summary.small))


def _tensors(arrays: Mapping[str, Map]) -> dict[str, Tensor]:
    """Arrays as batches of one."""
    return {
        name: torch.as_tensor(np.ascontiguousarray(array))[None] for name, array in arrays.items()
    }


@dataclass(frozen=True)
class NetworkBlender:
    """Blends views by a network that sees them, their coverage and the fused geometry (Sec. 3.3,
    Eqs. 4-5).

    Attributes:
        weights: file of the weights; those that ship unless given.
        guidance: which of those that ship, see `BlendNetworkShape`. A given file states it.
        device: where the network computes, see `compute_device`.
    """

    weights: Path | None = None
    guidance: Guidance = "registered"
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse a device that is not there."""
        compute_device(self.device)

    def blend(self, inputs: BlendingInputs) -> Blended:
        """Return the target view of one instant.

        Raises:
            DeviceError: the GPU's memory is out.
            WeightsError: no usable weights.
            RenderError: more source views than the network is made for.
        """
        inputs = without_blind(inputs)
        path, device = (
            self.weights or shipped_blend_weights(self.guidance),
            compute_device(self.device),
        )
        network, views = load_blend_network(path, device), len(inputs.instant.sources)
        if views > network.config.views:
            raise RenderError(
                f"{path.name}: a blending network for at most {network.config.views} source views, "
                f"got {views}; change the protocol's number of sources, or train one for more "
                "(ggvs-eval train blend --views)"
            )
        guidance = network.config.guidance
        if device.type != "cpu":
            return blend_on(network, blend_maps(inputs, guidance), device)
        if guidance == "registered":
            return blend_by(network, *registered(inputs, network.config.scale))
        return blend_by(network, blend_maps(inputs, guidance))


def without_blind(inputs: BlendingInputs) -> BlendingInputs:
    """The inputs without the views that cover no pixel of the target, unless none does: what is
    blind takes no view's place.
    """
    places = [
        k for k, splat in enumerate(inputs.splats) if splat.alpha.max(initial=0) >= COVERED_ALPHA
    ]
    if not 0 < len(places) < len(inputs.splats):
        return inputs
    instant = replace(inputs.instant, sources=tuple(inputs.instant.sources[k] for k in places))
    return replace(inputs, instant=instant, splats=[inputs.splats[k] for k in places])


def blend_by(network: BlendNetwork, maps: BlendMaps, summary: Overview | None = None) -> Blended:
    """Blend the views by a network; equal bits regardless of the number of threads.

    Compiled kernels compute it, `unet_outputs` at the network's own size and those of this module
    at full size.

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
    return Blended(
        refined(network.refiner, picture, depth, small, config.scale, len(maps.sources)), weights
    )


def _small_outputs(network: BlendNetwork, reduced: BlendMaps) -> tuple[Map, Map]:
    """`small_outputs` of the network for one instant, (K + 4 + F, h, w), and `view_shares` by them,
    (K, h, w).
    """
    from ggvs_eval.kernels import _core

    config = network.config
    views = len(reduced.sources)
    channels = network_channels(reduced, config.guidance, views)
    raw = unet_outputs(
        network.unet, channels, present_channels(views, config.views, config.guidance)
    )
    logarithms = np.log(np.maximum(reduced.weights, np.float32(NO_WEIGHT)))
    coverage, visibilities = (
        np.ascontiguousarray(array, np.float32)
        for array in (reduced.coverage, reduced.visibilities)
    )
    level = SIMD_LEVELS.index(get_simd_level())
    return _core.read_outputs(
        raw, logarithms, coverage, visibilities, config.views, SURE, get_threads(), level
    )


def blend_start(maps: BlendMaps) -> dict[str, Map]:
    """Return what a network starts from: geometric weights, and the blended views with holes
    filled, see `read_outputs`.
    """
    background = np.ascontiguousarray(np.moveaxis(filled_picture(maps), 2, 0))
    return {"weights": maps.weights, "unseen": maps.unseen(), "background": background}


def filled_picture(maps: BlendMaps) -> Map:
    """Return the views blended by coverage and their weights, what none covers filled from its
    surroundings, (H, W, 3).
    """
    blended = weighted_mean(list(maps.colours), list(maps.coverage), maps.weights.tolist())
    return push_pull(blended, np.max(maps.alphas, axis=0) > COVERED_ALPHA)
