"""SSIM over five scales (MS-SSIM), as pytorch-msssim computes it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image, check_pair, count_inside, require_finite, white_level
from ggvs_eval.metrics.metric import FURTHER, ViewMetric

# Wang, Simoncelli and Bovik 2003, from the finest scale to the coarsest.
WEIGHTS = np.array([0.0448, 0.2856, 0.3001, 0.2363, 0.1333])
WINDOW_PX = 11
SMALLEST_PX = (WINDOW_PX - 1) * 2 ** (len(WEIGHTS) - 1) + 1
Planes = NDArray[np.float64]


def ms_ssim(rendered: Image, truth: Image, mask: Mask | None = None) -> float:
    """Multi-scale structural similarity of one frame (Wang, Simoncelli, Bovik 2003), mean over the
    RGB channels.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1], at least 161 pixels high and wide.
        truth: captured frame, same shape and kind.
        mask: (H, W), the part that counts; None for the whole frame.

    Returns:
        Product over five scales of the mean contrast and structure, at the coarsest with luminance,
        each to its power; at most 1, higher is better.

    Raises:
        MetricError: shapes or kinds differ, the frames are too small, or the part holds no window
            of some scale.

    Example:
        >>> import numpy as np
        >>> truth = np.full((176, 176, 3), 100, np.uint8)
        >>> (
        ...     ms_ssim(truth, truth),
        ...     round(ms_ssim(truth // 2, truth), 2),
        ... )  # flat: luminance alone differs
        (1.0, 0.97)

    Reading:
        Gaussian window 11 x 11 at valid positions, data range 1, scales by the mean of 2 x 2
        pixels, negative means cut off at 0. Of a part count the windows whose centre is in it: no
        window of 11 pixels of the coarsest scale, 176 of the frame, would are wholly inside of what
        usually moves.
    """
    check_pair(rendered, truth)
    if min(truth.shape[:2]) < SMALLEST_PX:
        raise MetricError(
            f"MS-SSIM needs {SMALLEST_PX} pixels a side for five scales, got {truth.shape[0]} x "
            f"{truth.shape[1]}"
        )
    if mask is not None:
        count_inside(mask, truth.shape[:2])
    pair = rendered / white_level(rendered), truth / white_level(truth)
    factors: list[Planes] = []
    for scale, weight in enumerate(WEIGHTS):
        values = _maps(*pair)[0 if scale == len(WEIGHTS) - 1 else 1]
        mean = (
            values.mean(axis=(0, 1))
            if mask is None
            else _centred(values, mask, pair[0].shape).mean(axis=0)
        )
        factors.append(np.maximum(mean, 0) ** weight)
        pair = _halved(pair[0]), _halved(pair[1])
    return require_finite(float(np.prod(factors, axis=0).mean()), "MS-SSIM")


def _maps(x: Planes, y: Planes) -> tuple[Planes, Planes]:
    """SSIM, and its part of contrast and structure, at valid positions, (h, w, 3) each."""
    mean_x, mean_y = _blur(x), _blur(y)
    variances = _blur(x * x) - mean_x**2 + _blur(y * y) - mean_y**2
    contrast = (2 * (_blur(x * y) - mean_x * mean_y) + 0.03**2) / (variances + 0.03**2)
    return (2 * mean_x * mean_y + 0.01**2) / (mean_x**2 + mean_y**2 + 0.01**2) * contrast, contrast


def _centred(values: Planes, mask: Mask, shape: tuple[int, ...]) -> Planes:
    """Return the values of the windows of a scale whose centre is mostly inside, (N, 3)."""
    reach = WINDOW_PX // 2
    share = cv2.resize(mask.astype(np.float32), shape[1::-1], interpolation=cv2.INTER_AREA)
    window_values = values[share[reach:-reach, reach:-reach] >= 0.5]
    if not window_values.size:
        raise MetricError(
            "the region is too small, or too near the border, for a window of MS-SSIM's coarsest "
            "scales"
        )
    return window_values


def _blur(image: Planes) -> Planes:
    reach = WINDOW_PX // 2
    taps = cv2.getGaussianKernel(WINDOW_PX, 1.5)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, taps, taps))[reach:-reach, reach:-reach]


def _halved(image: Planes) -> Planes:
    """Return the means of 2 x 2 pixels; an odd size has a rim of zeros first."""
    padded = np.pad(image, [(size % 2, size % 2) for size in image.shape[:2]] + [(0, 0)])
    height, width = (size // 2 for size in padded.shape[:2])
    return np.asarray(
        padded[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1).mean(axis=(1, 3))
    )


MS_SSIM = ViewMetric(
    name="MS_SSIM",
    kind="frame",
    function=ms_ssim,
    higher_is_better=True,
    group=FURTHER,
    decimals=4,
    describe="structural similarity over five scales, RGB mean",
    reference="Wang, Simoncelli, Bovik 2003; as pytorch-msssim",
    inside=lambda pair, mask: ms_ssim(pair.rendered, pair.truth.image, mask),
    inside_note=" by windows whose centre is in it",
)
