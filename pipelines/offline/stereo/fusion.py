"""One depth map out of several partners' opinions: taken pair by pair, then consensus, flying pixels, smoothing, filling."""

from collections.abc import Sequence

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.geometry.rectification import RectifiedPair, depth_from_disparity, rectify
from ggvs_eval.pipelines.offline.stereo.matcher import StereoMatcher

FUSED_ROWS = 16  # at a time: what they need stays in the processor's cache


def fuse(depths: Map, confidences: Map, disparities: Map, error_px: float) -> tuple[Map, Map]:
    """Per pixel, the estimate that most others support, averaged with its supporters.

    An error of one pixel in a wide pair is a smaller error in depth than in a narrow one: two estimates agree when their
    disparity errors can explain the difference, and the average weighs each by the square of its disparity.

    Args:
        depths: estimates of N partners, (N, H, W), world units, 0 = invalid.
        confidences: theirs, (N, H, W), in [0, 1].
        disparities: the disparities they come from, (N, H, W), pixels.

    Returns:
        Depth (H, W), 0 where no partner has an opinion, and confidence (H, W): the supporters' summed confidence over N.
    """
    best, support = np.zeros_like(depths[0]), np.zeros_like(depths[0])
    for first in range(0, len(best), FUSED_ROWS):
        rows = slice(first, first + FUSED_ROWS)
        _fuse_rows(depths[:, rows], confidences[:, rows], disparities[:, rows], error_px, best[rows], support[rows])
    return best, support / np.float32(len(depths))


def _fuse_rows(depths: Map, confidences: Map, disparities: Map, error_px: float, best: Map, support: Map) -> None:
    """Write some rows of the fused depth and its support into `best` and `support`, both 0 before."""
    with np.errstate(divide="ignore"):
        share = np.where(depths > 0, np.float32(error_px) / disparities, np.float32(0))  # (N, H, W), error in units of the depth
    weights = confidences * np.square(disparities)
    for candidate, candidate_share in zip(depths, share, strict=True):
        agree = (depths > 0) & (np.abs(depths - candidate) <= (share + candidate_share) * candidate)  # (N, H, W)
        total = np.where(agree, confidences, np.float32(0)).sum(axis=0)
        better = total > support
        agreeing = np.where(agree, weights, np.float32(0))
        mean = np.divide((agreeing * depths).sum(axis=0), agreeing.sum(axis=0), out=np.zeros_like(best), where=better)
        np.copyto(best, mean, where=better)
        np.copyto(support, total, where=better)


def drop_flying_pixels(depth: Map, share: float) -> Map:
    """Invalidate pixels that stand alone between two surfaces.

    Args:
        depth: (H, W), 0 = invalid.
        share: a pixel flies when fewer than three of its eight neighbours lie within this share of its depth.

    Returns:
        What remains, (H, W).
    """
    height, width = depth.shape
    padded = np.pad(depth, 1)
    neighbours = np.zeros(depth.shape, np.uint8)
    for row, column in np.ndindex(3, 3):
        neighbours += np.abs(padded[row : row + height, column : column + width] - depth) < share * depth
    return np.where(neighbours >= 4, depth, np.float32(0))  # itself and three others


def smooth_surfaces(depth: Map, share: float, radius_px: int) -> Map:
    """Average depth within surfaces: bilateral in the logarithm of depth, so that steps much larger than `share` stay.

    Args:
        depth: (H, W), 0 = invalid and left so.
        share: standard deviation over depth, as a share of the depth.
    """
    logarithm = np.log(np.where(depth > 0, depth, np.float32(1e-6)))
    smooth = cv2.bilateralFilter(logarithm, 2 * radius_px + 1, share, radius_px * 0.75)
    return np.where(depth > 0, np.exp(smooth), np.float32(0))


def fill_background(depth: Map, confidence: Map, filled_confidence: float) -> tuple[Map, Map]:
    """Fill invalid pixels from the farther of the nearest valid pixels left and right, else above and below.

    What stereo cannot match is mostly background hidden from the partners, and depth must not be interpolated across edges.

    Args:
        depth: (H, W), 0 = invalid.
        confidence: (H, W).
        filled_confidence: confidence of filled pixels; 0 fills nothing.

    Returns:
        Filled depth and confidence, (H, W).
    """
    if filled_confidence <= 0:
        return depth, confidence
    filled = np.where(depth > 0, depth, _farther_neighbour(depth))
    filled = np.where(filled > 0, filled, _farther_neighbour(filled.T).T)
    return filled, np.where((depth == 0) & (filled > 0), np.float32(filled_confidence), confidence)


def _farther_neighbour(depth: Map) -> Map:
    """The larger of the nearest valid depths on the same row to the left and to the right, (H, W); 0 on empty rows."""
    columns = np.broadcast_to(np.arange(depth.shape[1]), depth.shape)
    left = np.maximum.accumulate(np.where(depth > 0, columns, 0), axis=1)
    right = np.minimum.accumulate(np.where(depth > 0, columns, depth.shape[1] - 1)[:, ::-1], axis=1)[:, ::-1]
    return np.maximum(np.take_along_axis(depth, left, axis=1), np.take_along_axis(depth, right, axis=1))


class PairwiseEstimator:
    """Depth of one camera by a stereo matcher; everything that does not depend on the images is prepared once.

    Args:
        error_px: estimates of two partners agree when disparity errors of this size explain their difference.
        warm: tell the matcher of each pair what it found at the call before; the calls must then be consecutive instants.
    """

    def __init__(
        self, camera: Camera, partners: Sequence[Camera], matcher: StereoMatcher, error_px: float, warm: bool = False
    ) -> None:
        self.matcher = matcher
        self.error_px = error_px
        self.warm = warm
        self._pairs = [rectify(camera, partner) for partner in partners]
        self._previous: list[Map | None] = [None] * len(self._pairs)

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Depth at one instant, invalid where no partner has an opinion.

        Returns:
            Depth, (H, W), and confidence: the share of partners that agree, weighted by their left-right agreement.
        """
        estimates = [self._match(index, image, other) for index, other in enumerate(partner_images)]
        depths, confidences, disparities = (np.stack(maps) for maps in zip(*estimates, strict=True))  # (N, H, W) each
        return DepthMap(*fuse(depths, confidences, disparities, self.error_px))

    def forget(self) -> None:
        """Begin a new sequence: the next call starts cold."""
        self._previous = [None] * len(self._pairs)

    def _match(self, index: int, image: Image8, partner_image: Image8) -> tuple[Map, Map, Map]:
        """One partner's depth, confidence and disparity at the camera's pixels, (H, W) each."""
        pair: RectifiedPair = self._pairs[index]
        left, right = pair.warp_left(image), pair.warp_right(partner_image)
        disparity, confidence = self.matcher.match(left, right, pair.d_min, pair.d_max, self._previous[index])
        if self.warm:
            self._previous[index] = disparity
        disparity = np.where(pair.sees(disparity), disparity, np.float32(0))
        return depth_from_disparity(pair, disparity, confidence)
