"""One stored depth map in a few numbers: how much was measured, how far the scene is, how well it makes other images again."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import CONFIDENCE_STEPS, DepthMap
from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.splat import COVERED_ALPHA, splat_depth
from ggvs_eval.geometry.warp import warp

SAME_SURFACE = 0.03  # of the median depth: what lies deeper behind another pixel is hidden by it
FEWEST_PIXELS = 100  # that both cameras see, to compare their colours


@dataclass(frozen=True)
class DepthStatistics:
    """Statistics of a depth map. Shares are of all pixels.

    Attributes:
        measured: share of pixels with a depth of their own.
        filled: share of pixels whose depth was filled in from others.
        empty: share of pixels without depth.
        confidence: median of the measured pixels, in [0, 1]; 0 where there are none.
        near: depth that 1 % of the measured pixels fall below, world units; 0 where there are none.
        median: median depth of the measured pixels.
        far: depth that 1 % of the measured pixels exceed.
    """

    frame: int
    measured: float
    filled: float
    empty: float
    confidence: float
    near: float
    median: float
    far: float


def measured_pixels(depth_map: DepthMap, filled_confidence: float) -> NDArray[np.bool_]:
    """Pixels with a depth of their own, (H, W).

    Reading:
        The store keeps no mark of filled pixels, only their low confidence. A measured pixel whose confidence is as low counts
        as filled; it is trusted no more than one.
    """
    filled = np.rint(filled_confidence * CONFIDENCE_STEPS) / CONFIDENCE_STEPS
    return (depth_map.depth > 0) & (depth_map.confidence > filled + 0.5 / CONFIDENCE_STEPS)


def describe_map(frame: int, depth_map: DepthMap, filled_confidence: float) -> DepthStatistics:
    """Count the pixels of a depth map; parameters as for `measured_pixels`."""
    measured, has_depth = measured_pixels(depth_map, filled_confidence), depth_map.depth > 0
    depths, shares = depth_map.depth[measured], (measured.mean(), (has_depth & ~measured).mean(), (~has_depth).mean())
    near, median, far = np.percentile(depths, (1, 50, 99)) if depths.size else (0.0, 0.0, 0.0)
    confidence = np.median(depth_map.confidence[measured]) if depths.size else 0.0
    return DepthStatistics(frame, *(float(value) for value in (*shares, confidence, near, median, far)))


@dataclass(frozen=True, eq=False)
class Resynthesis:
    """An image made again.

    Attributes:
        image: from the other camera's pixels, RGB uint8 (H, W, 3), its exposure fitted to this camera's.
        is_seen: pixels that the other camera sees as well, if the depth is right, (H, W).
        difference: from the true image, mean of the three channels, of 255 levels, (H, W); 0 where nothing is seen.
        gain: factor on red, green and blue that the exposure was fitted by.
    """

    image: Image8
    is_seen: NDArray[np.bool_]
    difference: Map
    gain: tuple[float, float, float]

    @property
    def covered(self) -> float:
        """Share of the pixels that both cameras see."""
        return float(self.is_seen.mean())

    @property
    def error(self) -> float:
        """Mean difference over them, of 255 levels; 0 where there are none."""
        return float(self.difference[self.is_seen].mean()) if self.is_seen.any() else 0.0


def resynthesise(camera: Camera, depth: Map, image: Image8, other: Camera, other_image: Image8) -> Resynthesis:
    """Look up each pixel of a camera in another camera's image, by its depth.

    Args:
        depth: (H, W), world units, 0 = invalid.
        image: what it saw, RGB uint8 (H, W, 3).

    Reading:
        What the other camera cannot see is found by this very depth map, seen from there, not by the other's own: then only one
        depth map is held at a time. The gain is the median ratio of the images, so that exposure does not pass for wrong depth.
    """
    has_depth = depth > 0
    tolerance = SAME_SURFACE * float(np.median(depth[has_depth])) if has_depth.any() else SAME_SURFACE * camera.near
    seen_from_there = _depth_from(camera, depth, other)
    other_colours = other_image.astype(np.float32) / np.float32(255)
    warped = warp(camera, depth, other, other_colours, seen_from_there, tolerance, bicubic=True)
    is_seen = has_depth & (warped.visibility > 0.5)
    gain = _gain(image[is_seen], warped.colour[is_seen] * 255)
    colour = warped.colour * np.asarray(gain, np.float32)
    difference = np.abs(np.clip(colour, 0, 1) * 255 - image).mean(axis=-1, dtype=np.float32)
    return Resynthesis(quantise(colour), is_seen, np.where(is_seen, difference, np.float32(0)), gain)


def _depth_from(camera: Camera, depth: Map, other: Camera) -> Map:
    """The depth map as the other camera sees it, (H', W'); 0 where it does not reach."""
    view = splat_depth(camera, depth, other, near=0.1 * min(camera.near, other.near))
    return np.where(view.alpha > COVERED_ALPHA, view.depth, np.float32(0))


def _gain(truth: NDArray[np.uint8], warped: NDArray[np.float32]) -> tuple[float, float, float]:
    """Median ratio of the pixels (N, 3) per channel; dark pixels tell only noise."""
    bright = (truth > 16) & (warped > 16)
    ratios = [truth[:, c][bright[:, c]] / warped[:, c][bright[:, c]] for c in range(3)]
    red, green, blue = (float(np.median(each)) if each.size >= FEWEST_PIXELS else 1.0 for each in ratios)
    return red, green, blue
