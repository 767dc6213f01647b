"""What any stereo matcher looks like to the rest: rectified pair in, disparity and confidence out."""

from typing import Protocol

from ggvs_eval.arrays import Image8, Map


class StereoMatcher(Protocol):
    """Finds for each pixel of the left image the one of the right image on the same row.

    A matcher is a frozen dataclass: its fields are its parameters and enter the key of what is stored.
    """

    @property
    def name(self) -> str:
        """Names the algorithm."""

    def match(self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None) -> tuple[Map, Map]:
        """Match a rectified pair.

        Args:
            left: RGB, (H, W, 3).
            right: RGB, (H, W, 3); the point at column x on the left lies at x - disparity.
            d_min: smallest disparity, pixels.
            d_max: largest disparity, pixels.
            previous: disparity of the left image of the frame before, (H, W), 0 = unknown; a matcher may start from it.

        Returns:
            Disparity of the left image in pixels, (H, W), 0 = rejected, and its confidence in [0, 1], (H, W).
        """
