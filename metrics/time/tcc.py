"""Steadiness of one view over time: temporal change consistency and the spread of the error over frames."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.psnr import require_finite, same_kind, ssim_per_channel
from ggvs_eval.metrics.inputs import Image, check_pair


def tcc(rendered: Sequence[Image] | Image, truth: Sequence[Image] | Image) -> float:
    """Temporal change consistency of one view (Eq. 8, after Zhang et al. 2019, on colour).

    Args:
        rendered: synthesised frames, T of (H, W, 3), uint8 in 0..255 or float in [0, 1], T >= 2.
        truth: captured frames of the same view and times.

    Returns:
        Mean of `temporal_change_ssim` over the T - 1 neighbouring pairs, 0 to 1; higher is better.

    Raises:
        MetricError: shapes or kinds differ, or fewer than 2 frames.

    Reading:
        The sensor noise of the truth is part of its change: a perfect but noise-free rendering does not reach 1, and flicker as
        strong as that noise is not punished. Read it beside STED.
    """
    if len(rendered) != len(truth):
        raise MetricError(f"TCC: {len(rendered)} rendered frames, {len(truth)} true frames; score the same frames")
    if len(truth) < 2:
        raise MetricError(f"TCC compares neighbouring frames: {len(truth)} frame; needs 2")
    changes = (temporal_change_ssim(rendered[t], rendered[t + 1], truth[t], truth[t + 1]) for t in range(len(truth) - 1))
    return float(np.mean(list(changes)))


def temporal_change_ssim(rendered: Image, rendered_next: Image, truth: Image, truth_next: Image) -> float:
    """SSIM of the absolute colour changes between two neighbouring frames, one term of Eq. 8.

    Args:
        rendered: synthesised frame at t, (H, W, 3), uint8 in 0..255 or float in [0, 1].
        rendered_next: synthesised frame at t + 1.
        truth: captured frame at t.
        truth_next: captured frame at t + 1.

    Returns:
        Similarity of |rendered_next - rendered| and |truth_next - truth|, 0 to 1.

    Raises:
        MetricError: shapes or kinds differ, or an image is smaller than the window of `ssim`.

    Reading:
        The paper names no SSIM. Taken as its authors' earlier released code does it for depth: the window of `ssim`, data range 1
        (the changes are not rescaled), the mean of each channel cut off at 0, then the mean of the channels.
    """
    check_pair(rendered, rendered_next)
    check_pair(truth, truth_next)
    changes = (_change(rendered, rendered_next), _change(truth, truth_next))
    return require_finite(float(np.maximum(ssim_per_channel(*changes), 0.0).mean()), "TCC")


def sdt(l1_255: ArrayLike, ddof: int = 1) -> float:
    """Standard deviation of the error over time, mean over the views; lower is steadier.

    Args:
        l1_255: L1 of each view and frame on the scale 0..255, (V, T), T >= 2.
        ddof: 1 for the unbiased estimate, 0 for the plain one.

    Raises:
        MetricError: not a table of views and frames, or fewer than 2 frames.

    Reading:
        The paper defines SDT by words only. A standard deviation per view over its per-frame errors (not per pixel, not of the
        error averaged over views) is what its sizes allow; ddof=1 is what its authors' earlier released code uses.
    """
    errors = np.asarray(l1_255, dtype=np.float64)
    if errors.ndim != 2 or errors.shape[1] < 2:
        raise MetricError(f"SDT wants errors of shape (views, frames) with at least 2 frames, got {errors.shape}")
    return require_finite(float(errors.std(axis=1, ddof=ddof).mean()), "SDT")


def _change(first: Image, second: Image) -> Image:
    """Absolute difference in the kind of the images; 8-bit ones do not wrap around."""
    return cv2.absdiff(*same_kind(first, second))
