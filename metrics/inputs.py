"""Input validation shared by all metrics: checks of the two images, and of the number computed from
them.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Mask
from ggvs_eval.errors import MetricError

LEAST_PIXELS = 64  # of a part of an image that is measured
LARGEST_FLOAT = 2.0  # a little above 1 is a rendering that overshoots, more is another scale
Image = NDArray[Any]  # uint8 in 0..255 or float in [0, 1]; `check_pair` sees to it


def check_pair(rendered: Image, truth: Image, ndim: int = 3) -> None:
    """Refuse two images, or two stacks of frames, that cannot be compared.

    Args:
        rendered: (H, W, 3), or (T, H, W, 3) with ``ndim=4``; uint8 in 0..255 or float in [0, 1].
    """
    if rendered.shape != truth.shape:
        raise MetricError(
            f"rendered is {rendered.shape}, truth is {truth.shape}; resize or render again, "
            f"metrics never resample"
        )
    if rendered.ndim != ndim or rendered.shape[-1] != 3 or 0 in rendered.shape:
        expected_shape = "(height, width, 3)" if ndim == 3 else "(frames, height, width, 3)"
        raise MetricError(f"wanted RGB of shape {expected_shape}, got {rendered.shape}")
    for name, image in (("rendered", rendered), ("truth", truth)):
        if image.dtype != np.uint8 and not np.issubdtype(image.dtype, np.floating):
            raise MetricError(
                f"{name}: wanted uint8 in 0..255 or float in [0, 1], got {image.dtype}"
            )
        if image.dtype != np.uint8 and LARGEST_FLOAT < image.max() < np.inf:
            raise MetricError(
                f"{name}: wanted float in [0, 1], got up to {image.max():.4g}; divide by 255"
            )
    if (rendered.dtype == np.uint8) != (truth.dtype == np.uint8):
        raise MetricError(
            f"rendered is {rendered.dtype}, truth is {truth.dtype}; quantise both or neither"
        )


def check_mask(mask: Mask, shape: tuple[int, ...]) -> None:
    """Refuse a mask that is not (H, W) of truth values."""
    if mask.shape != shape or mask.dtype != np.bool_:
        raise MetricError(f"mask: wanted {shape} bool, got {mask.shape} {mask.dtype}")


def white_level(image: Image) -> float:
    """Return the value of white: 255 for uint8, 1 for float."""
    return 255.0 if image.dtype == np.uint8 else 1.0


def same_kind(rendered: Image, truth: Image) -> tuple[Image, Image]:
    """Return both images as they are if 8-bit, else as float64: OpenCV compares one type only, and
    not every width of float.
    """
    if truth.dtype == np.uint8:
        return rendered, truth
    return rendered.astype(np.float64, copy=False), truth.astype(np.float64, copy=False)


def mean_inside(rendered: Image, truth: Image, mask: Mask, norm: int) -> float:
    """Return the mean over the pixels inside a mask and their channels of what one of OpenCV's
    norms adds up.

    Raises:
        MetricError: images or mask do not fit each other, or fewer than `LEAST_PIXELS` inside.
    """
    check_pair(rendered, truth)
    n_pixels = count_inside(mask, truth.shape[:2])
    return float(cv2.norm(*same_kind(rendered, truth), norm, mask.astype(np.uint8))) / (
        3 * n_pixels
    )


def count_inside(mask: Mask, shape: tuple[int, ...]) -> int:
    """Return the number of pixels inside a mask."""
    check_mask(mask, shape)
    n_pixels = int(np.count_nonzero(mask))
    if n_pixels < LEAST_PIXELS:
        raise MetricError(f"the region has {n_pixels} pixels; needs {LEAST_PIXELS}")
    return n_pixels


def require_finite(value: float, metric: str) -> float:
    """Return the value of a metric, or an error where a frame of floats held NaN or infinity: no
    score is NaN in silence.
    """
    if not np.isfinite(value):
        raise MetricError(
            f"{metric}: the frames hold values that are not finite; render them again"
        )
    return value
