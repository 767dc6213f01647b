"""OpenCV's semi-global matching over an image pyramid, checked left against right."""

from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.pipelines.offline.stereo.matcher import left_right_gap, refine_disparity

SUBPIXEL = 16  # OpenCV counts disparity in sixteenths of a pixel


@dataclass(frozen=True)
class SgbmMatcher:
    """Semi-global block matching after Hirschmueller, three aggregation directions.

    A point that fails the left-right check is looked up at half the size, and again: where a wall has too little texture for a
    small block, a larger one often has enough.

    Attributes:
        block: side of the matched block, pixels.
        p1: penalty of a disparity step of one pixel, per pixel of the block.
        p2: penalty of a larger step, per pixel of the block.
        levels: sizes at which the pair is matched, each half the one before.
        check_px: left and right may differ by max(check_px, check_share * disparity).
        check_share: see check_px.
        speckle_px: connected patches smaller than this are dropped.
        coarse_confidence: confidence of a level over that of the next finer one.
        refine_window: side of the window of the sub-pixel refinement, pixels.
        refine_iterations: its iterations.
    """

    block: int = 3
    p1: int = 8
    p2: int = 32
    levels: int = 3
    check_px: float = 1.0
    check_share: float = 0.03
    speckle_px: int = 100
    coarse_confidence: float = 0.5
    refine_window: int = 7
    refine_iterations: int = 2

    @property
    def name(self) -> str:
        """See StereoMatcher.name."""
        return "sgbm-3way"

    def match(self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None) -> tuple[Map, Map]:
        """Match a rectified pair, see StereoMatcher.match; the frame before is not needed."""
        pyramid = [tuple(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right))]
        for _ in range(1, self.levels):
            pyramid.append(tuple(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for image in pyramid[-1]))
        disparity = confidence = np.zeros((1, 1), np.float32)
        for level, (small_left, small_right) in reversed(list(enumerate(pyramid))):
            size, scale = small_left.shape[::-1], 2**level
            fine, fine_confidence = self._match_level(small_left, small_right, d_min // scale, -(-d_max // scale))
            kept = fine > 0
            disparity = np.where(kept, fine, 2 * _enlarge(disparity, size))
            coarse_confidence = self.coarse_confidence * cv2.resize(confidence, size, interpolation=cv2.INTER_NEAREST)
            confidence = np.where(kept, fine_confidence, coarse_confidence)
        return disparity, confidence

    def _match_level(self, left: Image8, right: Image8, d_min: int, d_max: int) -> tuple[Map, Map]:
        """Match grey images at one size; rejects what the right image does not confirm."""
        disparity = self._disparity(left, right, d_min, d_max)
        mirrored = self._disparity(np.fliplr(right), np.fliplr(left), d_min, d_max)
        gap = left_right_gap(disparity, np.fliplr(mirrored))
        allowed = np.maximum(self.check_px, self.check_share * disparity)
        kept = np.where((disparity > 0) & (gap <= allowed), disparity, np.float32(0))
        refined = refine_disparity(left, right, kept, self.refine_window, self.refine_iterations)
        return refined, np.where(refined > 0, 1 - 0.5 * gap / allowed, np.float32(0))

    def _disparity(self, left: Image8, right: Image8, d_min: int, d_max: int) -> Map:
        """Disparity of the left image in pixels, 0 = none found."""
        count = -(-(d_max - d_min + 1) // 16) * 16  # OpenCV wants a multiple of 16
        area = self.block**2
        sgbm = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=count,
            blockSize=self.block,
            P1=self.p1 * area,
            P2=self.p2 * area,
            disp12MaxDiff=-1,
            uniquenessRatio=0,
            speckleWindowSize=self.speckle_px,
            speckleRange=2,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )
        shifted = left[:, d_min:], right[:, : right.shape[1] - d_min]  # disparity d_min becomes 0
        # OpenCV leaves the first `count` columns unmatched.
        padded = [cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_REPLICATE) for image in shifted]
        sixteenths = sgbm.compute(*padded)[:, count:]
        disparity = np.where(sixteenths >= 0, sixteenths.astype(np.float32) / SUBPIXEL + d_min, np.float32(0))
        return np.pad(disparity, ((0, 0), (d_min, 0)))


def _enlarge(coarse: Map, size: tuple[int, int]) -> Map:
    """A coarse disparity map at full size, interpolated within surfaces only."""
    nearest = cv2.resize(coarse, size, interpolation=cv2.INTER_NEAREST)
    smooth = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
    return np.where(np.abs(smooth - nearest) < 0.75, smooth, nearest)
