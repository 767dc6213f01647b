"""Regions of a picture that are hard for stereo, from exact depth and the image."""

from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map, Mask
from ggvs_eval.errors import DepthError

REGIONS = ("texture", "untextured", "edge", "thin")


@dataclass(frozen=True)
class RegionOptions:
    """Thresholds between the regions.

    Attributes:
        step: a discontinuity bends inverse depth by more than this share of it from one pixel to
            the next but one.
        edge_px: edges reach this far to both sides of a discontinuity.
        thin_px: an object at most this wide in front of something farther is thin.
        thin_step: how much farther, as a share of the farther depth.
        slope: untextured is where the root mean square slope of the grey values stays below this,
            grey levels per pixel.
        slope_window_px: side of the window of that mean; odd.
    """

    step: float = 0.03
    edge_px: int = 4
    thin_px: int = 6
    thin_step: float = 0.05
    slope: float = 1.5
    slope_window_px: int = 9


def find_regions(depth: Map, image: Image8, options: RegionOptions) -> dict[str, Mask]:
    """Divide the pixels of known depth among the regions; each belongs to one.

    What is thin is thin, regardless of the rest; of the rest, what is next to a discontinuity is
    edge; of the rest, what shows next to no slope of grey values is untextured. The remainder is
    texture.

    Args:
        depth: exact, world units, 0 = unknown, (H, W).
        image: what the camera saw, RGB, (H, W, 3).
        options: parameters.

    Returns:
        A mask (H, W) for each of `REGIONS`.

    Raises:
        DepthError: image and depth differ in size.
    """
    if image.shape != (*depth.shape, 3):
        raise DepthError(
            f"regions: wanted an RGB image of {depth.shape}, the size of the depth, got "
            f"{image.shape}"
        )
    has_depth = depth > 0
    thin = has_depth & thin_structures(depth, options.thin_px, options.thin_step)
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * options.edge_px + 1,) * 2)
    beside = cv2.dilate(discontinuities(depth, options.step).astype(np.uint8), reach) > 0
    edge = has_depth & beside & ~thin
    plain = (
        has_depth & ~thin & ~edge & (slope_of_grey(image, options.slope_window_px) < options.slope)
    )
    return {
        "texture": has_depth & ~thin & ~edge & ~plain,
        "untextured": plain,
        "edge": edge,
        "thin": thin,
    }


def discontinuities(depth: Map, step: float) -> Mask:
    """Return the pixels at which depth jumps, on either side of the jump, (H, W).

    Planes are linear in inverse depth, however slanted they are: what bends it by more than `step`
    of itself from one neighbour to the opposite one is no surface. Unknown depth is infinitely far.
    """
    inverse = np.divide(1, depth, out=np.zeros(depth.shape, np.float64), where=depth > 0)
    jumps = np.zeros(depth.shape, bool)
    for values, mask in ((inverse, jumps), (inverse.T, jumps.T)):
        bend = np.abs(values[:, :-2] - 2 * values[:, 1:-1] + values[:, 2:])
        largest = np.maximum(np.maximum(values[:, :-2], values[:, 1:-1]), values[:, 2:])
        mask[:, 1:-1] |= bend > step * np.maximum(largest, 1e-12)
    return jumps


def thin_structures(depth: Map, width_px: int, step: float) -> Mask:
    """Pixels of what is at most `width_px` wide and nearer than what is behind by more than `step`
    of that depth, (H, W).

    A grey-scale closing raises each part that holds no square of `width_px` + 1 to the depth around
    it and leaves planes as they are. The picture's border cuts things off, which does not make them
    thin.
    """
    side = width_px + 1
    far = np.where(depth > 0, depth, depth.max(initial=0))
    padded = cv2.copyMakeBorder(far, side, side, side, side, cv2.BORDER_REPLICATE)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))[
        side:-side, side:-side
    ]
    return np.asarray(far < (1 - step) * closed, bool)


def slope_of_grey(image: Image8, window_px: int) -> Map:
    """Return the root mean square slope of the grey values in a window around each pixel, grey
    levels per pixel, (H, W).
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    across, down = (
        cv2.Sobel(grey, cv2.CV_32F, dx, dy, ksize=3, scale=1 / 8) for dx, dy in ((1, 0), (0, 1))
    )
    energy = cv2.blur(across * across + down * down, (window_px, window_px))
    return np.asarray(np.sqrt(np.maximum(energy, 0)), np.float32)
