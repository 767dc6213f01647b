"""Fidelity of one frame: PSNR, SSIM, L1, and PSNR after the best affine colour map."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval import kernels
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.colour_correction import apply_colour_map, fit_colour_map, unit_range
from ggvs_eval.metrics.inputs import Image, check_pair, white_level

PSNR_CEILING_DB = 100.0
SSIM_WINDOW_PX = 11


def psnr(rendered: Image, truth: Image) -> float:
    """Peak signal-to-noise ratio of one frame.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.

    Returns:
        10 log10(white^2 / MSE) over all pixels and channels, dB, at most 100; higher is better.

    Raises:
        MetricError: shapes or kinds differ.

    Reading:
        Identical frames would score infinity, and one of them would make every mean infinite. They score 100 dB, and so does what
        lies above: with 8 bits that is less than one step in one value of 25 000. A view's score is the mean of its PSNRs.
    """
    check_pair(rendered, truth)
    return decibels(_mean_squared_error(rendered, truth), white_level(truth))


def l1(rendered: Image, truth: Image) -> float:
    """Mean absolute error over pixels and channels on the scale 0..255; lower is better.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.

    Raises:
        MetricError: shapes or kinds differ.

    Reading:
        The paper prints no unit. Only 0..255 with the mean (not the sum) over channels fits its PSNR: 31.17 dB beside 5.09.
    """
    check_pair(rendered, truth)
    total = float(cv2.norm(*same_kind(rendered, truth), cv2.NORM_L1))
    return require_finite(total / truth.size * 255.0 / white_level(truth), "L1")


def ssim(rendered: Image, truth: Image) -> float:
    """Structural similarity of one frame (Wang et al. 2004), mean over the RGB channels.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.

    Returns:
        Mean similarity, at most 1; higher is better. Equal to scikit-image's ``structural_similarity`` with
        ``gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1`` within 1e-6.

    Raises:
        MetricError: shapes or kinds differ, or an image is smaller than the window.

    Reading:
        The paper names no variant. Taken: 11 x 11 Gaussian window, sigma 1.5, valid positions only, K = (0.01, 0.03), data
        range 1. Zero padding, a uniform window or data range 2, all in use, score 0.01 to 0.08 more on the same frame.
    """
    return require_finite(float(ssim_per_channel(rendered, truth).mean()), "SSIM")


def ssim_per_channel(rendered: Image, truth: Image) -> NDArray[np.float64]:
    """SSIM of each channel, (3,), as `ssim` defines it."""
    from ggvs_eval.kernels import _ssim

    check_pair(rendered, truth)
    height, width = truth.shape[:2]
    if min(height, width) < SSIM_WINDOW_PX:
        raise MetricError(f"SSIM needs {SSIM_WINDOW_PX} x {SSIM_WINDOW_PX} pixels for its window, got {height} x {width}")
    dtype = np.uint8 if truth.dtype == np.uint8 else np.float32
    first, second = (np.ascontiguousarray(image, dtype=dtype) for image in (rendered, truth))
    return _ssim.channel_means(first, second, kernels.get_threads(), kernels.SIMD_LEVELS.index(kernels.get_simd_level()))


def psnr_colour_corrected(rendered: Image, truth: Image) -> float:
    """PSNR after the affine colour map (3 x 4) that fits the rendered pixels best to the truth.

    Args:
        rendered: one frame (H, W, 3) or the frames of one view (T, H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: same shape and kind.

    Returns:
        PSNR in dB as in `psnr`; with a stack, one map for all frames and the mean over the frames.

    Raises:
        MetricError: shapes or kinds differ.

    Reading:
        See `ColourMoments`; the corrected frame is clipped to black and white and not rounded.
    """
    check_pair(rendered, truth, ndim=4 if truth.ndim == 4 else 3)
    rendered_frames, truth_frames = (image.reshape(-1, *truth.shape[-3:]) for image in (rendered, truth))
    colour_map = fit_colour_map(rendered_frames, truth_frames)
    frames = zip(rendered_frames, truth_frames, strict=True)
    return float(np.mean([psnr(apply_colour_map(colour_map, frame), unit_range(target)) for frame, target in frames]))


def same_kind(rendered: Image, truth: Image) -> tuple[Image, Image]:
    """Both images as they are if 8-bit, else as float64: OpenCV compares one type only, and not every width of float."""
    if truth.dtype == np.uint8:
        return rendered, truth
    return rendered.astype(np.float64, copy=False), truth.astype(np.float64, copy=False)


def require_finite(value: float, metric: str) -> float:
    """The value of a metric, or an error where a frame of floats held NaN or infinity: no score is NaN in silence.

    Raises:
        MetricError: the value is not finite.
    """
    if not np.isfinite(value):
        raise MetricError(f"{metric}: the frames hold values that are not finite; render them again")
    return value


def _mean_squared_error(rendered: Image, truth: Image) -> float:
    return float(cv2.norm(*same_kind(rendered, truth), cv2.NORM_L2SQR)) / truth.size


def decibels(mean_squared_error: float, white: float) -> float:
    """PSNR of a mean squared error of images whose white is `white`, at most `PSNR_CEILING_DB`.

    Raises:
        MetricError: the error is not finite.
    """
    floor = 10.0 ** (-PSNR_CEILING_DB / 10.0)
    return float(-10.0 * np.log10(max(require_finite(mean_squared_error, "PSNR") / white**2, floor)))
