"""Mean absolute error of a frame."""

import cv2

from ggvs_eval.arrays import Mask
from ggvs_eval.metrics.inputs import (
    Image,
    check_pair,
    mean_inside,
    require_finite,
    same_kind,
    white_level,
)
from ggvs_eval.metrics.metric import QUALITY, ViewMetric


def l1(rendered: Image, truth: Image) -> float:
    """Return the mean absolute error over pixels and channels on the scale 0..255; lower is better.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.

    Raises:
        MetricError: shapes or kinds differ.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> l1(truth + 5, truth)
        5.0

    Reading:
        The paper prints no unit. Only 0..255 with the mean (not the sum) over channels fits its
        PSNR: 31.17 dB with 5.09.
    """
    check_pair(rendered, truth)
    total = float(cv2.norm(*same_kind(rendered, truth), cv2.NORM_L1))
    return require_finite(total / truth.size * 255.0 / white_level(truth), "L1")


def masked_l1(rendered: Image, truth: Image, mask: Mask) -> float:
    """Return the mean absolute error of the pixels inside a mask on the scale 0..255.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: same shape and kind.
        mask: (H, W).

    Raises:
        MetricError: images or mask do not fit each other, or fewer than 64 pixels inside.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> masked_l1(truth + 5, truth, np.ones((16, 16), bool))
        5.0
    """
    return require_finite(
        mean_inside(rendered, truth, mask, cv2.NORM_L1) * 255.0 / white_level(truth), "L1"
    )


L1 = ViewMetric(
    name="L1",
    kind="frame",
    function=l1,
    unit="grey levels of 255",
    higher_is_better=False,
    group=QUALITY,
    decimals=2,
    describe="mean absolute error over pixels and channels",
    reference="Ha et al. 2025, section 4",
    inside=lambda pair, mask: masked_l1(pair.rendered, pair.truth.image, mask),
)
