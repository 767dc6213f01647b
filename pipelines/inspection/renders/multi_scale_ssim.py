"""SSIM over five scales (MS-SSIM), as pytorch-msssim computes it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8

# Wang, Simoncelli and Bovik 2003, from the finest scale to the coarsest.
WEIGHTS = np.array([0.0448, 0.2856, 0.3001, 0.2363, 0.1333])
WINDOW_PX = 11
SMALLEST_PX = (WINDOW_PX - 1) * 2 ** (len(WEIGHTS) - 1) + 1
Planes = NDArray[np.float64]


def multi_scale_ssim(rendered: Image8, truth: Image8) -> float:
    """MS-SSIM of two frames: data range 1, Gaussian window 11 x 11 at valid positions, product over the scales of each channel.

    Args:
        rendered: (H, W, 3), at least `SMALLEST_PX` high and wide.
        truth: same shape.
    """
    pair = rendered / 255, truth / 255
    factors: list[Planes] = []
    for scale, weight in enumerate(WEIGHTS):
        similarity, contrast = (values.mean(axis=(0, 1)) for values in _maps(*pair))
        is_coarsest = scale == len(WEIGHTS) - 1
        factors.append(np.maximum(similarity if is_coarsest else contrast, 0) ** weight)
        pair = _halved(pair[0]), _halved(pair[1])
    return float(np.prod(factors, axis=0).mean())


def _maps(x: Planes, y: Planes) -> tuple[Planes, Planes]:
    """SSIM, and its part of contrast and structure, at valid positions, (h, w, 3) each."""
    mean_x, mean_y = _blur(x), _blur(y)
    variances = _blur(x * x) - mean_x**2 + _blur(y * y) - mean_y**2
    contrast = (2 * (_blur(x * y) - mean_x * mean_y) + 0.03**2) / (variances + 0.03**2)
    return (2 * mean_x * mean_y + 0.01**2) / (mean_x**2 + mean_y**2 + 0.01**2) * contrast, contrast


def _blur(image: Planes) -> Planes:
    reach = WINDOW_PX // 2
    taps = cv2.getGaussianKernel(WINDOW_PX, 1.5)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, taps, taps))[reach:-reach, reach:-reach]


def _halved(image: Planes) -> Planes:
    """Means of 2 x 2 pixels; an odd size has a rim of zeros first."""
    padded = np.pad(image, [(size % 2, size % 2) for size in image.shape[:2]] + [(0, 0)])
    height, width = (size // 2 for size in padded.shape[:2])
    return np.asarray(padded[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1).mean(axis=(1, 3)))
