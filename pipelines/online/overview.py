"""What blending wants to know of all views before the network looks at them, in one pass over their maps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.online.blend_maps import BlendMaps


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

    arrays = (maps.colours, maps.coverage, maps.seen, maps.alphas)
    colours, coverage, seen, alphas = (np.ascontiguousarray(each, np.float32) for each in arrays)
    picture, unseen, covered, means = _core.overview(
        colours, coverage, seen, alphas, maps.weights, scale, COVERED_ALPHA, get_threads()
    )
    return Overview(maps.with_means(scale, means), unseen, picture, covered)
