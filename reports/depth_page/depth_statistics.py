"""One stored depth map in a few numbers: how much of it was measured, how much filled in, how far the scene is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.depth_store import CONFIDENCE_STEPS, DepthMap


@dataclass(frozen=True)
class DepthStatistics:
    """What a depth map consists of. Shares are of all pixels.

    Attributes:
        frame: the instant.
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

    Args:
        depth_map: as the store gives it.
        filled_confidence: `DepthOptions.filled_confidence` of its computation.

    Reading:
        The store keeps no mark of filled pixels, only their low confidence. A measured pixel whose confidence is as low counts
        as filled; it is trusted no more than one.
    """
    filled = np.rint(filled_confidence * CONFIDENCE_STEPS) / CONFIDENCE_STEPS
    return (depth_map.depth > 0) & (depth_map.confidence > filled + 0.5 / CONFIDENCE_STEPS)


def describe_map(frame: int, depth_map: DepthMap, filled_confidence: float) -> DepthStatistics:
    """Count the pixels of a depth map; parameters as for `measured_pixels`."""
    measured, known = measured_pixels(depth_map, filled_confidence), depth_map.depth > 0
    depths, shares = depth_map.depth[measured], (measured.mean(), (known & ~measured).mean(), (~known).mean())
    near, median, far = np.percentile(depths, (1, 50, 99)) if depths.size else (0.0, 0.0, 0.0)
    confidence = np.median(depth_map.confidence[measured]) if depths.size else 0.0
    return DepthStatistics(frame, *(float(value) for value in (*shares, confidence, near, median, far)))
