"""How much of the composed picture each view is, for people who ask why a pixel flickers."""

import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.pipelines.online.blend_maps import BlendMaps
from ggvs_eval.pipelines.online.blend_network import SURE
from ggvs_eval.pipelines.online.refiner import NO_WEIGHT


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
