"""One depth map out of several partners' opinions: consensus, flying pixels, smoothing, filling."""

import cv2
import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.depth_store import is_known

FUSED_ROWS = 16  # at a time: what they need stays in the processor's cache


def fuse(depths: Map, confidences: Map, disparities: Map, error_px: float) -> tuple[Map, Map]:
    """Per pixel, the estimate that most others support, averaged with its supporters.

    An error of one pixel in a wide pair is a smaller error in depth than in a narrow one: two
    estimates agree when their disparity errors can explain the difference, and the average weighs
    each by the square of its disparity.

    Args:
        depths: estimates of N partners, (N, H, W), world units, 0 = invalid.
        confidences: theirs, (N, H, W), in [0, 1].
        disparities: the disparities they come from, (N, H, W), pixels.

    Returns:
        Depth (H, W), 0 if no partner has an opinion, and confidence (H, W): the supporters' summed
        confidence over N.
    """
    best, support = np.zeros_like(depths[0]), np.zeros_like(depths[0])
    for first in range(0, len(best), FUSED_ROWS):
        rows = slice(first, first + FUSED_ROWS)
        _fuse_rows(
            depths[:, rows],
            confidences[:, rows],
            disparities[:, rows],
            error_px,
            best[rows],
            support[rows],
        )
    return best, support / np.float32(len(depths))


def _fuse_rows(
    depths: Map, confidences: Map, disparities: Map, error_px: float, best: Map, support: Map
) -> None:
    """Write some rows of the fused depth and its support into `best` and `support`, both 0
    before.
    """
    with np.errstate(divide="ignore"):
        # (N, H, W), error in units of the depth
        share = np.where(depths > 0, np.float32(error_px) / disparities, np.float32(0))
    weights = confidences * np.square(disparities)
    for candidate, candidate_share in zip(depths, share, strict=True):
        # (N, H, W)
        agree = (depths > 0) & (np.abs(depths - candidate) <= (share + candidate_share) * candidate)
        total = np.where(agree, confidences, np.float32(0)).sum(axis=0)
        better = total > support
        agreeing = np.where(agree, weights, np.float32(0))
        mean = np.divide(
            (agreeing * depths).sum(axis=0),
            agreeing.sum(axis=0),
            out=np.zeros_like(best),
            where=better,
        )
        np.copyto(best, mean, where=better)
        np.copyto(support, total, where=better)


def drop_flying_pixels(depth: Map, share: float) -> Map:
    """Invalidate isolated pixels between two surfaces.

    Args:
        depth: (H, W), 0 = invalid.
        share: a pixel flies when fewer than three of its eight neighbours are within this share of
            its depth.

    Returns:
        What remains, (H, W).
    """
    height, width = depth.shape
    padded = np.pad(depth, 1)
    neighbours = np.zeros(depth.shape, np.uint8)
    for row, column in np.ndindex(3, 3):
        neighbours += (
            np.abs(padded[row : row + height, column : column + width] - depth) < share * depth
        )
    return np.where(neighbours >= 4, depth, np.float32(0))  # itself and three others


def smooth_surfaces(depth: Map, share: float, radius_px: int) -> Map:
    """Average depth within surfaces: bilateral in the logarithm of depth, so that steps much larger
    than `share` stay.

    Args:
        depth: (H, W), 0 = invalid and left so.
        share: standard deviation over depth, as a share of the depth.
    """
    logarithm = np.log(np.where(depth > 0, depth, np.float32(1e-6)))
    smooth = cv2.bilateralFilter(logarithm, 2 * radius_px + 1, share, radius_px * 0.75)
    return np.where(depth > 0, np.exp(smooth), np.float32(0))


def fill_background(depth: Map, confidence: Map, filled_confidence: float) -> tuple[Map, Map]:
    """Fill invalid pixels from the farther of the nearest valid pixels left and right, else above
    and below.

    What stereo cannot match is mostly background hidden from the partners, and depth must not be
    interpolated across edges.

    Args:
        depth: (H, W), 0 = invalid.
        confidence: (H, W).
        filled_confidence: confidence of filled pixels; 0 fills nothing.

    Returns:
        Filled depth and confidence, (H, W).
    """
    if filled_confidence <= 0:
        return depth, confidence
    mask = is_known(depth)
    depth = np.where(mask, depth, np.float32(0))
    filled = np.where(mask, depth, _farther_neighbour(depth))
    filled = np.where(filled > 0, filled, _farther_neighbour(filled.T).T)
    return filled, np.where(~mask, np.float32(filled_confidence) * (filled > 0), confidence)


def _farther_neighbour(depth: Map) -> Map:
    """Return the larger of the nearest valid depths on the same row to the left and to the right,
    (H, W); 0 on empty rows.
    """
    columns = np.broadcast_to(np.arange(depth.shape[1]), depth.shape)
    left = np.maximum.accumulate(np.where(depth > 0, columns, 0), axis=1)
    right = np.minimum.accumulate(
        np.where(depth > 0, columns, depth.shape[1] - 1)[:, ::-1], axis=1
    )[:, ::-1]
    return np.maximum(
        np.take_along_axis(depth, left, axis=1), np.take_along_axis(depth, right, axis=1)
    )
