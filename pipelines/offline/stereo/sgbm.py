"""Semi-global matching, as OpenCV does it, over an image pyramid, checked left against right."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads
from ggvs_eval.pipelines.offline.stereo.matcher import left_right_gap, refine_disparity
from ggvs_eval.pipelines.offline.stereo.pairwise import StereoMatcher

Side = Literal["left", "right"]
SUBPIXEL = 16  # the kernel counts disparity in sixteenths of a pixel
UNMATCHED = -16  # no disparity, in these
SPECKLE_RANGE = 2 * SUBPIXEL  # neighbours that differ by less are one patch


@dataclass(frozen=True)
class SgbmMatcher(StereoMatcher):
    """Semi-global block matching after Hirschmueller, three aggregation directions.

    A point that fails the left-right check is looked up at half the size, and again: where a wall
    has too little texture for a small block, a larger one often has enough.

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
    """

    name = "sgbm-3way"
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

    def match(
        self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None
    ) -> tuple[Map, Map]:
        """Match a rectified pair, see StereoMatcher.match; the frame before is not needed."""
        return self.match_sides(left, right, d_min, d_max, ("left",))[0]

    def match_sides(
        self, left: Image8, right: Image8, d_min: int, d_max: int, sides: Sequence[Side]
    ) -> list[tuple[Map, Map]]:
        """Match a rectified pair for either or both of its images: the check of one against the
        other finds both anyway.

        Args:
            left: RGB, (H, W, 3).
            right: RGB, (H, W, 3).
            d_min: smallest disparity, pixels.
            d_max: largest disparity, pixels.

        Returns:
            For each side disparity and confidence, (H, W) each, as `match` gives them for the left
            one; a point in column x of the right one is at x + disparity on the left.
        """
        pyramid = [tuple(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right))]
        while len(pyramid) < self.levels and min(pyramid[-1][0].shape) > 1:
            pyramid.append(
                tuple(
                    cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                    for image in pyramid[-1]
                )
            )
        results = [(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32)) for _ in sides]
        for level, (small_left, small_right) in reversed(list(enumerate(pyramid))):
            fine = self._match_level(
                small_left, small_right, d_min // 2**level, -(-d_max // 2**level), sides
            )
            results = [
                self._completed(*result, *coarse)
                for result, coarse in zip(fine, results, strict=True)
            ]
        return [
            (np.fliplr(result[0]), np.fliplr(result[1])) if side == "right" else result
            for side, result in zip(sides, results, strict=True)
        ]

    def _completed(
        self, fine: Map, fine_confidence: Map, coarse: Map, coarse_confidence: Map
    ) -> tuple[Map, Map]:
        """Disparities of one size, its gaps filled by those of the smaller one."""
        size, mask = fine.shape[::-1], fine > 0
        disparity = np.where(mask, fine, 2 * _enlarge(coarse, size))
        enlarged = self.coarse_confidence * cv2.resize(
            coarse_confidence, size, interpolation=cv2.INTER_NEAREST
        )
        return disparity, np.where(mask, fine_confidence, enlarged)

    def _match_level(
        self, left: Image8, right: Image8, d_min: int, d_max: int, sides: Sequence[Side]
    ) -> list[tuple[Map, Map]]:
        """Match grey images at one size, the right one in its mirror image.

        Rejects what the other does not confirm.
        """
        mirrored = np.fliplr(right), np.fliplr(left)
        of_left, of_right = (
            self._disparity(left, right, d_min, d_max),
            self._disparity(*mirrored, d_min, d_max),
        )
        tried = {
            "left": (left, right, of_left, np.fliplr(of_right)),
            "right": (*mirrored, of_right, np.fliplr(of_left)),
        }
        return [self._checked(*tried[side]) for side in sides]

    def _checked(
        self, left: Image8, right: Image8, disparity: Map, disparity_right: Map
    ) -> tuple[Map, Map]:
        """Return the disparities that the right image confirms, refined, and their confidence."""
        gap = left_right_gap(disparity, disparity_right)
        allowed = np.maximum(self.check_px, self.check_share * disparity)
        checked = np.where((disparity > 0) & (gap <= allowed), disparity, np.float32(0))
        refined = refine_disparity(left, right, checked, self.refine_window, self.refine_iterations)
        return refined, np.where(refined > 0, 1 - 0.5 * gap / allowed, np.float32(0))

    def _disparity(self, left: Image8, right: Image8, d_min: int, d_max: int) -> Map:
        """Disparity of the left image in pixels, 0 = none found, as where none of its columns has a
        match in the right one.
        """
        if left.shape[1] <= d_min:
            return np.zeros(left.shape, np.float32)
        from ggvs_eval.kernels import _stereo

        count = -(-(d_max - d_min + 1) // 16) * 16  # the kernel wants a multiple of 16
        area = self.block**2
        shifted = left[:, d_min:], right[:, : right.shape[1] - d_min]  # disparity d_min becomes 0
        # The kernel leaves the first `count` columns unmatched.
        first, second = (np.pad(image, ((0, 0), (count, 0)), "edge") for image in shifted)
        steps, level = (self.p1 * area, self.p2 * area), SIMD_LEVELS.index(get_simd_level())
        matched = _stereo.match_blocks(
            first, second, count, self.block // 2, *steps, get_threads(), level
        )
        # of the unmatched ones one takes part
        sixteenths = cv2.medianBlur(matched[:, count - 1 :], 3)
        cv2.filterSpeckles(sixteenths, UNMATCHED, self.speckle_px, SPECKLE_RANGE)
        sixteenths = sixteenths[:, 1:]
        disparity = np.zeros(left.shape, np.float32)
        np.copyto(
            disparity[:, d_min:],
            sixteenths / np.float32(SUBPIXEL) + np.float32(d_min),
            where=sixteenths >= 0,
        )
        return disparity


def _enlarge(coarse: Map, size: tuple[int, int]) -> Map:
    """Return a coarse disparity map at full size, interpolated within surfaces only."""
    nearest = cv2.resize(coarse, size, interpolation=cv2.INTER_NEAREST)
    smooth = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
    return np.where(np.abs(smooth - nearest) < 0.75, smooth, nearest)
