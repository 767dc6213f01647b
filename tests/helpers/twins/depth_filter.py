"""The temporal depth filter in a page of numpy and OpenCV."""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map


def difference_mask_twin(
    current: Image8,
    previous: Image8,
    *,
    lambda_t: float = 0.7,
    beta: float = 0.6,
    channels: str = "largest",
) -> Map:
    """What `ggvs_eval.geometry.difference_mask.difference_mask` computes (Eq. 1): images averaged
    down, then subtracted.
    """
    height, width = current.shape[:2]
    size = (max(width // 4, 1), max(height // 4, 1))
    now, before = (
        cv2.resize(image.astype(np.float32) / 255.0, size, interpolation=cv2.INTER_AREA)
        for image in (current, previous)
    )
    differences = np.abs(now - before)
    difference = differences.max(axis=-1) if channels == "largest" else differences.mean(axis=-1)
    mask = cv2.dilate(np.minimum(difference / lambda_t + beta, 1.0), np.ones((3, 3), np.uint8))
    return np.asarray(
        cv2.resize(mask, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32
    )


def filter_depth_twin(depth: Map, history: Map, mask: Map, tolerance: float) -> Map:
    """What `filter_depth` computes (Eq. 2)."""
    same = np.abs(depth - history) <= tolerance * np.maximum(depth, np.float32(1e-9))
    mixed = np.where(same & (history > 0), mask * depth + (1.0 - mask) * history, depth)
    lost = (depth <= 0) & (mask < 1.0)
    return np.where(lost, history, np.where(depth > 0, mixed, 0.0)).astype(np.float32)
