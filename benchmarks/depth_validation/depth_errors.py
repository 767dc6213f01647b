"""Depth errors against the truth: the share of pixels within 2 %, the median relative error, the
share rejected.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks.depth_validation.figures import Measure
from ggvs_eval.arrays import Map
from ggvs_eval.errors import DepthError

WITHIN = 0.02
MEASURES = (
    Measure("within_2_percent", "%", higher_is_better=True),
    Measure("median_error_percent", "%", higher_is_better=False),
    Measure("rejected_percent", "%", higher_is_better=False),
)


def relative_errors(depth: Map, truth: Map) -> Map:
    """Return the share by which depth differs from the truth.

    Args:
        depth: any shape, world units, 0 = no depth.
        truth: the same shape, positive.

    Returns:
        |depth / truth - 1|, the same shape; no depth counts as an error of 1, so that rejecting
        pixels cannot help.

    Raises:
        DepthError: shapes differ, or a truth that is not positive.
    """
    if depth.shape != truth.shape:
        raise DepthError(
            f"depth errors: wanted depth and truth of one shape, got {depth.shape} and "
            f"{truth.shape}"
        )
    if not (truth > 0).all():
        raise DepthError(
            f"depth errors: wanted a positive true depth, got {truth.min():g}; evaluate known "
            f"pixels only"
        )
    return np.where(depth > 0, np.abs(depth / truth - 1), np.float32(1)).astype(np.float32)


def summarise(errors: Sequence[Map], rejected: Sequence[Map]) -> dict[str, float]:
    """Return the measures over the pixels of all pictures together.

    Args:
        errors: of each picture, `relative_errors`.
        rejected: of each picture, 1 where the matcher had no estimate; same shapes.

    Raises:
        DepthError: no pixel at all.
    """
    pooled = (
        np.concatenate([each.ravel() for each in errors]) if errors else np.empty(0, np.float32)
    )
    if not pooled.size:
        raise DepthError(
            "depth errors: wanted at least one pixel, got none; choose other cameras or a larger "
            "picture"
        )
    share_rejected = np.concatenate([each.ravel() for each in rejected]).mean()
    values = (100 * (pooled <= WITHIN).mean(), 100 * np.median(pooled), 100 * share_rejected)
    return {measure.name: float(value) for measure, value in zip(MEASURES, values, strict=True)}
