"""Fill what no camera sees from its surroundings."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.baselines.method import Map


def push_pull(colour: Map, known: NDArray[np.bool_]) -> Map:
    """Fill unknown pixels from ever coarser averages of the known ones (push-pull, Gortler et al. 1996).

    Args:
        colour: (H, W, 3), float32; values of unknown pixels are ignored.
        known: (H, W).

    Returns:
        Image, (H, W, 3), float32; known pixels keep their colour.
    """
    return _fill(colour, known.astype(np.float32))


def _fill(colour: Map, known: Map) -> Map:
    """One level: average down what is known, fill the smaller image, and take from it what is unknown here."""
    height, width = known.shape
    if min(height, width) < 2 or known.all():
        return colour
    size = ((width + 1) // 2, (height + 1) // 2)
    weight = _resize(known, size, cv2.INTER_AREA)
    total = _resize(colour * known[..., None], size, cv2.INTER_AREA)
    average = np.divide(total, np.maximum(weight, 1e-6)[..., None], dtype=np.float32)
    coarse = _fill(average, np.minimum(weight * np.float32(4), np.float32(1)))
    filled = _resize(coarse, (width, height), cv2.INTER_LINEAR)
    return filled + known[..., None] * (colour - filled)


def _resize(image: Map, size: tuple[int, int], interpolation: int) -> Map:
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), dtype=np.float32)
