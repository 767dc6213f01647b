"""The left-right check: what the right image says of the point that a left pixel was matched with."""

import numpy as np

from ggvs_eval.arrays import Map


def left_right_gap(disparity: Map, disparity_right: Map) -> Map:
    """How far the right image's disparity at the matched point is from the left one's.

    Args:
        disparity: of the left image, (H, W), pixels.
        disparity_right: of the right image, (H, W), pixels, 0 = rejected.

    Returns:
        Distance in pixels, (H, W); inf where the right image has no disparity or does not show the point.
    """
    width = disparity.shape[1]
    columns = np.rint(np.arange(width, dtype=np.float32) - disparity).astype(np.intp)
    matched = np.take_along_axis(disparity_right, np.clip(columns, 0, width - 1), axis=1)
    return np.where((matched > 0) & (columns >= 0), np.abs(disparity - matched), np.float32(np.inf))
