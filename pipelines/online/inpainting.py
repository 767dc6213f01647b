"""Fill what no camera sees from its surroundings."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.kernels import get_threads


def push_pull(colour: Map, known: NDArray[np.bool_]) -> Map:
    """Fill unknown pixels from ever coarser averages of the known ones (push-pull, Gortler et al. 1996).

    Args:
        colour: (H, W, 3), float32; values of unknown pixels are ignored.
        known: (H, W).

    Returns:
        Image, (H, W, 3), float32; known pixels keep their colour.
    """
    from ggvs_eval.kernels import _core

    return _core.push_pull(np.ascontiguousarray(colour, np.float32), np.ascontiguousarray(known, np.bool_), get_threads())
