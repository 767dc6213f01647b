"""Common parts of matchers of rectified images: the left-right check and subpixel refinement.

Semi-global matching interpolates its costs between whole pixels and so prefers whole pixels; on
short baselines that bias is the largest error in depth. Least squares on the images
(one-dimensional Lucas-Kanade) take it away.
"""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.geometry.rectification import at_matches

LARGEST_STEP_PX = 0.5  # larger corrections mean that the match itself is wrong
NOISE_SLOPE = 4.0  # mean squared slope that noise alone makes, squared grey values per pixel


def left_right_gap(disparity: Map, disparity_right: Map) -> Map:
    """Measure the distance of the right image's disparity at the matched point from the left one's.

    Args:
        disparity: of the left image, (H, W), pixels.
        disparity_right: of the right image, (H, W), pixels, 0 = rejected.

    Returns:
        Distance in pixels, (H, W); inf where the right image has no disparity or does not show the
        point.
    """
    matched = at_matches(disparity_right, disparity)
    return np.where(matched > 0, np.abs(disparity - matched), np.float32(np.inf))


def refine_disparity(
    left: Image8, right: Image8, disparity: Map, window: int, iterations: int
) -> Map:
    """Move each disparity to where the right image's surroundings fit the left one's best.

    The right image may be exposed differently: the offset is free in each window, the gain is one
    for all matched points.

    Args:
        left: grey values, (H, W).
        right: grey values, (H, W).
        disparity: (H, W), pixels, 0 = invalid and left so.
        window: side of the surroundings, pixels.
        iterations: of the least squares; 2 converge from half a pixel.

    Returns:
        Refined disparity, (H, W), at most half a pixel per iteration from what was given.
    """
    from ggvs_eval.kernels import _stereo

    valid = disparity > 0
    if not valid.any():
        return disparity
    left, right, disparity = (
        np.ascontiguousarray(left),
        np.ascontiguousarray(right),
        np.ascontiguousarray(disparity),
    )
    matched = _stereo.sample_matches(right, disparity)
    gain = float(left[valid].astype(np.float32).std() / max(matched[valid].std(), np.float32(1)))
    slope = np.asarray(cv2.Sobel(right, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8), np.float32)
    return _stereo.refine_matches(
        left, right, slope, disparity, gain, window, iterations, LARGEST_STEP_PX, NOISE_SLOPE
    )
