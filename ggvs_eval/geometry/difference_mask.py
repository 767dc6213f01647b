"""Difference masks: where a camera's image moves (Eq. 1)."""

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.kernels import get_threads

REDUCTION = 4  # masks are computed at a quarter of the image size


def difference_mask(
    current: Image8,
    previous: Image8,
    *,
    lambda_t: float = 0.7,
    beta: float = 0.6,
    channels: Literal["largest", "mean"] = "largest",
) -> NDArray[np.float32]:
    """Return the weight of the new depth against the filtered history, per pixel of one source
    camera (Eq. 1).

    Args:
        current: frame at instant t, RGB uint8, (H, W, 3).
        previous: frame at instant t - 1, same shape.
        lambda_t: absolute colour difference, in [0, 1], that counts as motion.
        beta: smallest weight, what a still pixel gets.
        channels: whether the largest difference of the three counts, or their mean.

    Returns:
        M^t, (H, W), float32 in [beta, 1].

    Examples:
        >>> black, white = np.zeros((8, 8, 3), np.uint8), np.full((8, 8, 3), 255, np.uint8)
        >>> difference_mask(black, black)[0, :2], difference_mask(white, black)[0, :2]
        (array([0.6, 0.6], dtype=float32), array([1., 1.], dtype=float32))

    Reading:
        The paper does not say how three channels become one: the largest difference counts, which
        is the most sensitive to motion. Both images are averaged down before they are subtracted,
        so that sensor noise is averaged too.
    """
    change = colour_change(current, previous)
    return mask_of(change, current.shape[:2], lambda_t=lambda_t, beta=beta, channels=channels)


def colour_change(current: Image8, previous: Image8) -> Map:
    """Change of the mean colour of each cell, (H / 4, W / 4, 3), float32 in [-1, 1], between two
    images of `difference_mask`.
    """
    from ggvs_eval.kernels import _core

    height, width = current.shape[:2]
    cells = (max(height // REDUCTION, 1), max(width // REDUCTION, 1))
    return _core.colour_change(
        np.ascontiguousarray(current), np.ascontiguousarray(previous), cells, get_threads()
    )


def mask_of(
    change: Map,
    size: tuple[int, int],
    *,
    lambda_t: float,
    beta: float,
    channels: Literal["largest", "mean"],
) -> NDArray[np.float32]:
    """Return the mask of a `colour_change` at the images' size, height and width.

    The rest as in `difference_mask`.
    """
    red, green, blue = np.moveaxis(np.abs(change), -1, 0)
    difference = (
        np.maximum(np.maximum(red, green), blue)
        if channels == "largest"
        else (red + green + blue) / np.float32(3)
    )
    mask = np.minimum(difference / np.float32(lambda_t) + np.float32(beta), np.float32(1.0))
    mask = cv2.dilate(mask, np.ones((3, 3), np.uint8))  # 3x3 max pooling
    return np.asarray(
        cv2.resize(mask, size[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32
    )
