"""Diagnostics: a method's intermediate maps, as pictures beside its frames that the page shows."""

from collections.abc import Callable, Mapping

import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.colour_maps import coloured, depth_colours

# Okabe and Ito's colours, which the colour-blind tell apart: one for each source view, nearest first.
VIEW_COLOURS = np.array(
    [(230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0), (204, 121, 167)], np.float32
)


def diagnostics_picture(name: str, values: Map, target: Camera) -> Image8:
    """One map of `Rendering.diagnostics` in the colours of its kind, (h, w, 3)."""
    return _PICTURES[name](values, target)


def view_colours(weights: Map) -> Image8:
    """Weights as a mixture of one colour per source view; dark where the background takes over.

    Args:
        weights: (K, h, w); what is missing to a sum of 1 is the background's. From the eighth view on colours come again.
    """
    colours = np.take(VIEW_COLOURS, np.arange(len(weights)), axis=0, mode="wrap")
    return np.rint(np.einsum("khw,kc->hwc", weights, colours).clip(0, 255)).astype(np.uint8)


def _depth(depth: Map, target: Camera) -> Image8:
    return depth_colours(depth, target.near, target.far)


def _share(values: Map, target: Camera) -> Image8:
    del target
    return coloured(values, "cividis", np.ones(values.shape, np.bool_))


def _views(weights: Map, target: Camera) -> Image8:
    del target
    return view_colours(weights)


_PICTURES: Mapping[str, Callable[[Map, Camera], Image8]] = {
    "depth": _depth,
    "weights": _views,
    "coverage": _share,
    "motion": _share,
}
