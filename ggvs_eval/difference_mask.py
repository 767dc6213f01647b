"""Difference masks: where a camera's image moves (Eq. 1)."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.images import Image8

REDUCTION = 4  # masks are computed at a quarter of the image size


def difference_mask(current: Image8, previous: Image8, *, lambda_t: float = 0.7, beta: float = 0.6) -> NDArray[np.float32]:
    """Weight of the new depth against the filtered history, per pixel of one source camera (Eq. 1).

    Args:
        current: frame at instant t, RGB uint8, (H, W, 3).
        previous: frame at instant t - 1, same shape.
        lambda_t: absolute colour difference, in [0, 1], that counts as motion.
        beta: smallest weight, what a still pixel gets.

    Returns:
        M^t, (H, W), float32 in [beta, 1].

    Reading:
        The paper does not say how three channels become one: the largest difference counts, which is the most sensitive to
        motion. Both images are averaged down before they are subtracted, so that sensor noise is averaged too.
    """
    height, width = current.shape[:2]
    small_size = (max(width // REDUCTION, 1), max(height // REDUCTION, 1))
    small_now, small_before = (
        cv2.resize(image.astype(np.float32) / 255.0, small_size, interpolation=cv2.INTER_AREA) for image in (current, previous)
    )
    difference = np.abs(small_now - small_before).max(axis=-1)  # (H / 4, W / 4)
    mask = np.minimum(difference / lambda_t + beta, 1.0)
    mask = cv2.dilate(mask, np.ones((3, 3), np.uint8))  # 3x3 max pooling
    return np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)
