"""PSNR of a frame."""

import cv2
import numpy as np

from ggvs_eval.arrays import Mask
from ggvs_eval.metrics.inputs import (
    Image,
    check_pair,
    mean_inside,
    require_finite,
    same_kind,
    white_level,
)
from ggvs_eval.metrics.metric import QUALITY, FramePair, ViewMetric

PSNR_CEILING_DB = 100.0


def psnr(rendered: Image, truth: Image) -> float:
    """Peak signal-to-noise ratio of one frame.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.

    Returns:
        10 log10(white^2 / MSE) over all pixels and channels, dB, at most 100; higher is better.

    Raises:
        MetricError: shapes or kinds differ.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> round(psnr(truth + 5, truth), 2)  # 20 log10(255 / 5)
        34.15

    Reading:
        Identical frames would score infinity, and one of them would make every mean infinite. They
        score 100 dB, and so does what is above: with 8 bits that is less than one step in one value
        of 25 000. A view's score is the mean of its PSNRs.
    """
    check_pair(rendered, truth)
    return decibels(_mean_squared_error(rendered, truth), white_level(truth))


def masked_psnr(rendered: Image, truth: Image, mask: Mask) -> float:
    """PSNR of the pixels inside a mask, dB, at most 100.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: same shape and kind.
        mask: (H, W).

    Raises:
        MetricError: images or mask do not fit each other, or fewer than 64 pixels inside.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> rendered, left = truth.copy(), np.arange(16) < 8
        >>> rendered[:, ~left] = 0
        >>> masked_psnr(rendered, truth, np.tile(left, (16, 1)))
        100.0
    """
    mean_squared_error = mean_inside(rendered, truth, mask, cv2.NORM_L2SQR)
    return decibels(mean_squared_error, white_level(truth))


def decibels(mean_squared_error: float, white: float) -> float:
    """PSNR of a mean squared error of images whose white is `white`, at most `PSNR_CEILING_DB`."""
    floor = 10.0 ** (-PSNR_CEILING_DB / 10.0)
    return float(
        -10.0 * np.log10(max(require_finite(mean_squared_error, "PSNR") / white**2, floor))
    )


def _mean_squared_error(rendered: Image, truth: Image) -> float:
    return float(cv2.norm(*same_kind(rendered, truth), cv2.NORM_L2SQR)) / truth.size


def _inside(pair: FramePair, mask: Mask) -> float:
    return masked_psnr(pair.rendered, pair.truth.image, mask)


PSNR = ViewMetric(
    name="PSNR",
    kind="frame",
    function=psnr,
    unit="dB",
    higher_is_better=True,
    group=QUALITY,
    decimals=2,
    describe="peak signal-to-noise ratio of the 8-bit frame",
    reference="Ha et al. 2025, section 4",
    has_ceiling=True,
    inside=_inside,
)
