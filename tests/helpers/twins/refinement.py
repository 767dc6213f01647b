"""Least squares on the images by cv2.remap and cv2.blur."""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map


def refine_twin(
    left: Image8, right: Image8, disparity: Map, gain: float, window: int, iterations: int
) -> Map:
    """What `_stereo.refine_matches` computes, for steps of at most 0.5 pixels and noise of 4;
    arguments as there.
    """
    slope = cv2.Sobel(right, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    rows, columns = np.indices(disparity.shape, dtype=np.float32)
    valid = disparity > 0
    weight = valid.astype(np.float32)
    share = np.maximum(cv2.blur(weight, (window, window)), np.float32(1e-6))

    def mean(values: Map) -> Map:
        return cv2.blur(values * weight, (window, window)) / share

    refined = disparity
    for _ in range(iterations):
        slopes = np.float32(gain) * look_up(slope, columns - refined, rows)
        difference = left.astype(np.float32) - np.float32(gain) * look_up(
            right.astype(np.float32), columns - refined, rows
        )
        mean_slope, mean_difference = mean(slopes), mean(difference)
        covariance = mean(slopes * difference) - mean_slope * mean_difference
        variance = np.maximum(mean(slopes * slopes) - mean_slope * mean_slope, np.float32(0))
        step = -covariance / (variance + np.float32(4))
        refined = np.where(
            valid, refined + np.clip(step, np.float32(-0.5), np.float32(0.5)), np.float32(0)
        )
    return np.maximum(refined, 0)


def look_up(image: Map, columns: Map, rows: Map) -> Map:
    """Values between the columns, those of the nearest one beyond the ends."""
    return cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
