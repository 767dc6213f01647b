"""Steadiness over the views of one instant."""

import numpy as np
from numpy.typing import ArrayLike

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.psnr import require_finite


def sdv(l1_255: ArrayLike, ddof: int = 1) -> float:
    """Standard deviation of the error over the views, mean over the frames; lower is more even.

    Args:
        l1_255: L1 of each view and frame on the scale 0..255, (V, T), V >= 2.
        ddof: 1 for the unbiased estimate, 0 for the plain one; with 3 views they differ by 22 %.

    Raises:
        MetricError: not a table of views and frames, fewer than 2 views, or values that are not finite.

    Reading:
        Defined by words only in the paper; read as the mirror of `tcc.sdt`, ddof=1 as there.
    """
    errors = np.asarray(l1_255, dtype=np.float64)
    if errors.ndim != 2 or errors.shape[0] < 2 or errors.shape[1] < 1:
        raise MetricError(f"SDV wants errors of shape (views, frames) with at least 2 views, got {errors.shape}")
    return require_finite(float(errors.std(axis=0, ddof=ddof).mean()), "SDV")
