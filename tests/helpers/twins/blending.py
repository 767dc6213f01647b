"""Means over views, the look-up and push-pull in a page of numpy and OpenCV."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.method import SourceView
from helpers.twins.warp import warp_twin


def weighted_mean_twin(colours: Sequence[Map], weights: Sequence[Map]) -> Map:
    """What `ggvs_eval.geometry.per_pixel.weighted_mean` computes."""
    total = np.zeros(weights[0].shape, np.float32)
    mean = np.zeros((*weights[0].shape, 3), np.float32)
    for colour, weight in zip(colours, weights, strict=True):
        total += weight
        mean += weight[..., None] * colour[..., :3]
    return mean / np.maximum(total, np.float32(1e-30))[..., None]


def look_up_twin(
    target: Camera,
    target_depth: Map,
    sources: Sequence[SourceView],
    weights: Sequence[float],
    background: Map,
    tolerance: float,
) -> NDArray[np.float64]:
    """What `ggvs_eval.geometry.look_up` computes: warp every view, then blend."""
    warped = [
        warp_twin(
            target,
            target_depth,
            view.camera,
            view.image / 255.0,
            view.depth,
            tolerance,
            bicubic=True,
        )
        for view in sources
    ]
    counts = [each.visibility * weight for each, weight in zip(warped, weights, strict=True)]
    foreground = weighted_mean_twin([each.colour for each in warped], counts)
    seen = np.minimum(np.sum([each.visibility for each in warped], axis=0), 1.0)
    return foreground + (1 - seen)[..., None] * (background - foreground)


def push_pull_twin(colour: Map, known: NDArray) -> Map:
    """What `push_pull` computes; ``known`` is 0 or 1 at first, from 0 to 1 at the coarser
    levels.
    """
    height, width = known.shape
    known = known.astype(np.float32)
    if min(height, width) < 2 or known.all():
        return colour
    size = ((width + 1) // 2, (height + 1) // 2)
    weight = _resize(known, size, cv2.INTER_AREA)
    total = _resize(
        np.where(known[..., None] > 0, colour * known[..., None], np.float32(0)),
        size,
        cv2.INTER_AREA,
    )
    average = total / np.maximum(weight, np.float32(1e-6))[..., None]
    filled = _resize(
        push_pull_twin(average, np.minimum(weight * 4, 1)), (width, height), cv2.INTER_LINEAR
    )
    return np.where(known[..., None] > 0, filled + known[..., None] * (colour - filled), filled)


def _resize(image: Map, size: tuple[int, int], interpolation: int) -> Map:
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), dtype=np.float32)
