"""Full-size passes around the blending network by compiled kernels: all views at one glance, composition, refinement.

The torch code of `blend_network` and `refiner` says the same, is what training differentiates, and defines these in the tests.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.geometry.warp import registration_arguments
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads, side_by_side
from ggvs_eval.pipelines.online.blend_maps import FAINT, BlendMaps, in_order, maps_of
from ggvs_eval.pipelines.online.blend_network import BEYOND_VIEWS, SURE
from ggvs_eval.pipelines.online.blending import BlendingInputs
from ggvs_eval.pipelines.online.packed_layers import packed_once, parameter_map
from ggvs_eval.pipelines.online.refiner import (
    COLOUR_GAIN,
    LEAST,
    ROW_STEP_PX,
    STATISTICS_GAIN,
    STATISTICS_GRID,
    TYPICAL,
    Refiner,
)

OUTPUT_MULTIPLE = 8  # of a layer: so many are summed at once


@dataclass(frozen=True, eq=False)
class Overview:
    """The views at one glance.

    Attributes:
        small: `BlendMaps.reduced`.
        unseen: `BlendMaps.unseen`, (H, W), in [0, 1].
        picture: the views blended by coverage and their weights, black where none has any, (H, W, 3).
        covered: where a splat shows something, (H, W).
    """

    small: BlendMaps
    unseen: Map
    picture: Map
    covered: NDArray[np.bool_]


def overview(maps: BlendMaps, scale: int) -> Overview:
    """All that follows from the views alone.

    Args:
        maps: the K views.
        scale: of the network, see `BlendNetworkOptions`.
    """
    from ggvs_eval.kernels import _core

    arrays = (maps.colours, maps.coverage, maps.visibilities)
    colours, coverage, visibilities = (np.ascontiguousarray(each, np.float32) for each in arrays)
    alphas = [np.ascontiguousarray(each, np.float32) for each in maps.alphas]
    found = _core.overview(colours, coverage, visibilities, alphas, _depths(maps), *_overview_settings(maps.weights, scale))
    return _overview(maps, scale, *found)


def registered(inputs: BlendingInputs, scale: int) -> tuple[BlendMaps, Overview]:
    """`blend_maps` with registered views, and their `overview`, in one pass: while the views lie in the cache."""
    from ggvs_eval.kernels import _core

    target, (sources, splats) = inputs.instant.target, in_order(inputs)
    registration = registration_arguments(target, inputs.depth, sources, splats, inputs.tau)
    weights = view_weights(target, [source.camera for source in sources], [source.share for source in sources])
    depths = [np.ascontiguousarray(each, np.float32) for each in (*(view.depth for view in splats), inputs.depth)]
    arguments = (*registration, float(FAINT), depths, *_overview_settings(weights, scale))
    stacks, found = _core.register_and_overview(*arguments)
    maps = maps_of(inputs, stacks)
    return maps, _overview(maps, scale, *found)


def _depths(maps: BlendMaps) -> list[Map]:
    return [np.ascontiguousarray(each, np.float32) for each in (*maps.depths, maps.fused_depth)]


def _overview_settings(weights: Map, scale: int) -> tuple[Map, int, float, int, int]:
    return weights, scale, COVERED_ALPHA, get_threads(), SIMD_LEVELS.index(get_simd_level())


def _overview(
    maps: BlendMaps, scale: int, picture: Map, unseen: Map, covered: NDArray[np.bool_], means: Sequence[Map], depths: Map
) -> Overview:
    return Overview(maps.with_means(scale, means, depths), unseen, picture, covered)


@dataclass(frozen=True, eq=False)
class Composed:
    """The composed picture and how sure it is.

    Attributes:
        picture: (3, H, W), float32.
        spread: standard deviation of the views, (H, W).
        shown: sum of the views' coverages, (H, W).
    """

    picture: Map
    spread: Map
    shown: Map

    def image(self) -> Map:
        """The picture, (H, W, 3), in [0, 1]."""
        return np.ascontiguousarray(np.moveaxis(self.picture, 0, -1).clip(0, 1))


def composed(maps: BlendMaps, unseen: Map, background: Map, small: Map, scale: int) -> Composed:
    """The views by the network's weights, over the background (Eqs. 4-5): `read_outputs` and `compose_tensors` in one pass.

    Args:
        maps: the K views.
        unseen: how little of what the target sees is shown, (H, W).
        background: the picture filled from its surroundings, (H, W, 3).
        small: `small_outputs` of the network, (K + 4 + F, h, w).
        scale: so many times smaller they are per side.
    """
    from ggvs_eval.kernels import _core

    views = np.ascontiguousarray(maps.colours, np.float32), np.ascontiguousarray(maps.coverage, np.float32)
    level = SIMD_LEVELS.index(get_simd_level())
    return Composed(*_core.compose(*views, unseen, background, small, scale, SURE, get_threads(), level))


def refined(refiner: Refiner, picture: Composed, depth: Map | None, small: Map, scale: int, views: int) -> Map:
    """Refine the picture, (H, W, 3), in [0, 1]: `evidence` and `Refiner.forward` tile by tile.

    Args:
        picture: what the network's outputs compose.
        depth: fused depth, (H, W), 0 where unknown; None if the network must not see it.
        small: as in `composed`.
        scale: as in `composed`.
        views: K.
    """
    from ggvs_eval.kernels import _core

    depth = np.zeros_like(picture.spread) if depth is None else np.ascontiguousarray(depth, np.float32)
    layers = _conditioned(packed_once(refiner, None, lambda: _layers(refiner)), refiner, picture)
    evidence = picture.picture, picture.spread, picture.shown, depth
    return _core.refine(*evidence, small, scale, views + BEYOND_VIEWS, layers, get_threads(), SIMD_LEVELS.index(get_simd_level()))


def _conditioned(layers: list[tuple[Map, Map, int]], refiner: Refiner, picture: Composed) -> list[tuple[Map, Map, int]]:
    """The layers as the statistics of a picture change them: shifted biases, scaled inputs of the last one.

    Weights of half precision times statistics of few bits are exact in doubles, sums too: equal bits on every processor.
    """
    weights, bias = (parameter_map(refiner.condition, name).astype(np.float64) for name in ("weight", "bias"))
    *shifts, gain = np.split(((weights * statistics_of(picture)).sum(axis=1) + bias).astype(np.float32), 3)
    shifted = [
        (filters, bias + np.pad(shift, (0, len(bias) - len(shift))), count)
        for (filters, bias, count), shift in zip(layers[:-1], shifts, strict=True)
    ]
    taps, *rest = layers[-1]
    return [*shifted, (taps * (1 + gain)[:, None], *rest)]


def statistics_of(picture: Composed) -> NDArray[np.float64]:
    """`picture_statistics` by numpy, (4,), with equal bits: torch's threads, once woken, would spin beside those of the kernels.

    Args:
        picture: what the network's outputs compose.
    """
    spread, detail = side_by_side(
        lambda: _log_means(np.clip(np.float32(COLOUR_GAIN) * picture.spread[::ROW_STEP_PX], -1, 1)),
        lambda: _log_means(_detail(picture.picture)),
    )
    return np.round(STATISTICS_GAIN * (np.array([*spread, *detail]) - TYPICAL) * STATISTICS_GRID) / STATISTICS_GRID


def _detail(picture: Map) -> Map:
    """Absolute second differences of the mean colour, of every eighth row; 0 in a picture that has none."""
    parts = slice(1, -1, ROW_STEP_PX), slice(0, -2, ROW_STEP_PX), slice(2, None, ROW_STEP_PX)
    red, green, blue = picture
    rows, above, below = ((red[part] + green[part] + blue[part]) / np.float32(3) for part in parts)
    detail = np.abs(rows - (above + below) / 2)[:, 1:-1] + np.abs(rows[:, 1:-1] - (rows[:, :-2] + rows[:, 2:]) / 2)
    return detail if detail.size else np.zeros(1, np.float32)


def _log_means(values: Map) -> list[float]:
    """Logarithms of the geometric and of the arithmetic mean."""
    wide = values.astype(np.float64)
    return [float(np.log(wide + LEAST).mean()), float(np.log(wide.mean() + LEAST))]


def _layers(refiner: Refiner) -> list[tuple[Map, Map, int]]:
    """Packed filters, bias and number of outputs of each layer; of the last one weights (inputs, outputs filled up)."""
    from ggvs_eval.kernels import _core

    looks = [(parameter_map(look, "weight"), parameter_map(look, "bias")) for look in refiner.looks]
    weights, bias = parameter_map(refiner.taps, "weight")[:, :, 0, 0], parameter_map(refiner.taps, "bias")
    missing = -len(bias) % OUTPUT_MULTIPLE
    taps = np.ascontiguousarray(np.pad(weights.T, [(0, 0), (0, missing)])), np.pad(bias, (0, missing)), len(bias)
    return [*((*_core.pack_filters(*look), len(look[1])) for look in looks), taps]
