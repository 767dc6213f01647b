"""Sharpness of an image: the contrast of neighbouring pixels, shown next to every value that blur
improves.
"""

import cv2

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image, require_finite, same_kind, white_level
from ggvs_eval.metrics.metric import NO_REFERENCE, Series, ViewMetric

PERCENT = 100.0


def sharpness(image: Image) -> float:
    """Return the mean absolute difference of neighbouring pixels, the total variation over space
    per pixel.

    Args:
        image: (H, W, 3), uint8 in 0..255 or float in [0, 1].

    Returns:
        Mean over channels of the mean over horizontal and over vertical neighbours, per cent of
        white. Of two renderings of one scene the blurred one has less; noise raises it.

    Raises:
        MetricError: not RGB, below 2 x 2 pixels, or values that are not finite.

    Example:
        >>> import numpy as np
        >>> stripes = np.zeros((4, 4, 3), np.uint8)
        >>> stripes[:, ::2] = (
        ...     51  # every neighbour to the side is a fifth of white away, none above or below
        ... )
        >>> sharpness(stripes)
        10.0

    Reading:
        In the units of mTV, so that their ratio is a shift: a picture that moves by a small part of
        a pixel from frame to frame changes by that part of its mean difference along the motion.
    """
    if image.ndim != 3 or image.shape[-1] != 3 or min(image.shape[:2]) < 2:
        raise MetricError(
            f"sharpness: wanted RGB (height, width, 3) of 2 x 2 pixels or more, got {image.shape}"
        )
    across = mean_difference(image[:, 1:], image[:, :-1])
    down = mean_difference(image[1:], image[:-1])
    return require_finite((across + down) / 2, "sharpness")


def mean_difference(first: Image, second: Image) -> float:
    """Return the mean absolute difference over pixels and channels, per cent of white."""
    return (
        PERCENT
        * float(cv2.norm(*same_kind(first, second), cv2.NORM_L1))
        / (white_level(first) * first.size)
    )


SHARPNESS = ViewMetric(
    name="Sharpness",
    kind="frame",
    function=lambda rendered, _truth: sharpness(rendered),
    unit="% of white",
    higher_is_better=True,
    group=NO_REFERENCE,
    decimals=3,
    describe="mean absolute difference of neighbouring pixels; higher stability with lower "
    "sharpness is blur, noise raises it",
    reference="docs/metrics.md",
    series=Series(1, lambda frames, _static: sharpness(*frames)),
)
