"""The flow that RAFT-Stereo starts from: semi-global matching at half size, its gaps filled from the background.

From zero, RAFT-Stereo walks the whole disparity in small steps; from a guess that is right nearly everywhere, a small network
with few iterations is left with what matching cannot do.
"""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher

HALF = SgbmMatcher(levels=2, refine_iterations=0, speckle_px=40)


def start_from_matching(left: Image8, right: Image8, d_min: int, d_max: int, factor: int) -> Map:
    """Initial flow of the network.

    Args:
        left: RGB, (H, W, 3), sizes multiples of `factor`.
        d_min: smallest disparity, pixels.
        d_max: largest disparity, pixels.
        factor: pixels per cell of the flow.

    Returns:
        Negative disparity in cells, (H / factor, W / factor).
    """
    half_size = left.shape[1] // 2, left.shape[0] // 2
    halves = [cv2.resize(image, half_size, interpolation=cv2.INTER_AREA) for image in (left, right)]
    disparity, _ = HALF.match(halves[0], halves[1], d_min // 2, -(-d_max // 2))
    return start_from_disparity(disparity, factor // 2)


def start_from_disparity(disparity: Map, factor: int) -> Map:
    """A disparity map as flow of the network: gaps filled, one value per cell.

    Args:
        disparity: (H, W), pixels, 0 = unknown, sizes multiples of `factor`.
        factor: pixels per cell.

    Returns:
        Negative disparity in cells, (H / factor, W / factor).
    """
    cells = disparity.shape[1] // factor, disparity.shape[0] // factor
    filled = fill_from_background(disparity)
    return np.asarray(-cv2.resize(filled, cells, interpolation=cv2.INTER_NEAREST) / factor, np.float32)


def fill_from_background(disparity: Map) -> Map:
    """Give rejected pixels (0) the smaller of the nearest disparities left and right on their row, else of the rows around."""
    filled = np.where(disparity > 0, disparity, _smaller_neighbour(disparity))
    return np.where(filled > 0, filled, _smaller_neighbour(filled.T).T)


def _smaller_neighbour(disparity: Map) -> Map:
    columns = np.broadcast_to(np.arange(disparity.shape[1]), disparity.shape)
    mask = disparity > 0
    left = np.maximum.accumulate(np.where(mask, columns, 0), axis=1)
    right = np.minimum.accumulate(np.where(mask, columns, disparity.shape[1] - 1)[:, ::-1], axis=1)[:, ::-1]
    sides = np.stack([np.take_along_axis(disparity, side, axis=1) for side in (left, right)])
    smaller = np.where(sides > 0, sides, np.inf).min(axis=0)
    return np.where(np.isfinite(smaller), smaller, 0).astype(np.float32)
