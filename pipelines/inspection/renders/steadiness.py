"""Steadiness without truth, under question: whether blur bought a good one."""

from collections.abc import Mapping

import numpy as np

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.regions import moving_mask
from ggvs_eval.metrics.image.sharpness import sharpness
from ggvs_eval.metrics.time.temporal_variation import mtv
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames

PAIRS_PER_VIEW = 3
BLURRED_BELOW = 0.95  # of the capture's sharpness, noise of the capture included


def change_inside(after: Image8, before: Image8, mask: Mask | None) -> float | None:
    """Return the mTV of two neighbouring frames inside a mask, or everywhere.

    None if it has too few pixels.
    """
    try:
        return mtv(after, before, mask)
    except MetricError:  # too few pixels are static
        return None


def steadiness_line(views: Mapping[str, ViewFrames]) -> str:
    """State the change of renders in static areas, their sharpness, and whether blur can explain
    it.

    Args:
        views: name -> rendered and captured frames, of which a few neighbours are read.

    Returns:
        A sentence with the values of the renders and of the capture; empty if no frame has the size
        of its truth, the view has one frame, or nothing is static.
    """
    values = []
    for view in views.values():
        starts = np.unique(
            np.linspace(view.frames.start, view.frames.stop - 2, PAIRS_PER_VIEW).round().astype(int)
        )
        for index in (int(start) for start in starts if len(view.frames) > 1):
            (before, true_before), (after, true_after) = view.pairs([index, index + 1])
            if {before.shape, after.shape, true_before.shape} != {true_after.shape}:
                continue
            static = ~moving_mask(true_after, true_before)
            changes = (
                change_inside(after, before, static),
                change_inside(true_after, true_before, static),
            )
            if changes[0] is not None:
                values.append((*changes, sharpness(after), sharpness(true_after)))
    if not values:
        return ""
    change, true_change, sharp, true_sharp = np.array(values, dtype=np.float64).mean(axis=0)
    text = (
        f"in static areas the renders change by {change:.3f} % of white per frame (mTV x 100), the "
        f"capture, noise included, by {true_change:.3f} %; the sharpness of the renders is "
        f"{sharp:.2f} %, of the capture {true_sharp:.2f} %"
    )
    is_blurred = change < true_change and sharp < BLURRED_BELOW * true_sharp
    return text + (": more stable but blurrier than the capture" if is_blurred else "")
