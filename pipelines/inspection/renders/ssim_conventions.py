"""Conventions of SSIM: window, border, data range, covariance, colour; and DSSIM."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.pipelines.inspection.renders.frame_conventions import BT601, cropped
from ggvs_eval.pipelines.inspection.renders.recompute import FrameMeasure, MaskReader, Recomputed, frame_means, mean_over_views
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames

Planes = NDArray[np.float64]
Levels = NDArray[Any]
GAUSSIAN: dict[str, Any] = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
OUR_SSIM = "Gaussian 11 x 11, valid positions, range 1"
UNIFORM_RANGE_1 = "uniform 7 x 7, range 1 (scikit-image on uint8)"
UNIFORM_RANGE_2 = "uniform 7 x 7, range 2 (scikit-image on float, no range given; EasyVolcap)"


def ssim_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """SSIM as scikit-image, kornia and the code bases of this field compute it."""
    rows = frame_means(views, frame_measures(), OUR_SSIM)
    rows += [_halved(row) for row in rows if row.name in (OUR_SSIM, UNIFORM_RANGE_1, UNIFORM_RANGE_2)]
    return rows + _blackened(views, masks) if all(view in masks for view in views) else rows


def frame_measures() -> dict[str, FrameMeasure]:
    """Name -> SSIM of two uint8 frames."""
    return {
        OUR_SSIM: partial(similarity, **GAUSSIAN),
        "Gaussian 11 x 11, valid positions, range 2": partial(similarity, data_range=2.0, **GAUSSIAN),
        "Gaussian 11 x 11, valid positions, range of the true frame": partial(similarity, data_range=None, **GAUSSIAN),
        "Gaussian 11 x 11, sample covariance, range 1": partial(similarity, **{**GAUSSIAN, "use_sample_covariance": True}),
        "Gaussian 11 x 11, zero-padded, range 1 (3DGS)": partial(padded, border=cv2.BORDER_CONSTANT),
        "Gaussian 11 x 11, reflect-padded, range 1 (kornia)": partial(padded, border=cv2.BORDER_REFLECT_101),
        "Gaussian 11 x 11, valid positions, range 1, luma": partial(similarity, luma=True, **GAUSSIAN),
        UNIFORM_RANGE_1: similarity,
        UNIFORM_RANGE_2: partial(similarity, data_range=2.0),
        "uniform 7 x 7, range 255 on images in 0..1": partial(similarity, data_range=255.0),
        "uniform 7 x 7, range of the true frame": partial(similarity, data_range=None),
        "uniform 7 x 7, population covariance, range 1": partial(similarity, use_sample_covariance=False),
        "uniform 7 x 7, range 1, luma": partial(similarity, luma=True),
        "uniform 7 x 7, range 1, without a border of 10 % (ENeRF)": lambda *pair: similarity(*cropped(*pair)),
    }


def similarity(rendered: Levels, truth: Levels, data_range: float | None = 1.0, luma: bool = False, **options: Any) -> float:
    """scikit-image's SSIM of two frames, (H, W, 3) or (H, W).

    Args:
        rendered: on the scale 0..255.
        truth: same shape.
        data_range: where images are taken to 0..1; None for the range of the true frame's levels.
        luma: compare luma instead of the channels.
        options: handed on.
    """
    from skimage.metrics import structural_similarity

    first, second = (image @ BT601 / 255 if luma else image / 255 for image in (rendered, truth))
    levels = float(second.max() - second.min()) if data_range is None else data_range
    axis = 2 if second.ndim == 3 else None
    return float(structural_similarity(first, second, data_range=levels or 1.0, channel_axis=axis, **options))


def padded(rendered: Levels, truth: Levels, border: int) -> float:
    """SSIM with a Gaussian window at every pixel, also where it reaches beyond the border.

    Args:
        rendered: (H, W, 3), on the scale 0..255.
        truth: same shape.
        border: OpenCV's name for what lies there: zeros in the 3DGS family, the reflected image in kornia.
    """
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    taps /= taps.sum()

    def blur(image: Planes) -> Planes:
        return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, taps, taps, borderType=border))

    x, y = (image / 255 for image in (rendered, truth))
    mean_x, mean_y = blur(x), blur(y)
    variance_x, variance_y = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2
    covariance = blur(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + 0.01**2) / (mean_x**2 + mean_y**2 + 0.01**2)
    return float((luminance * (2 * covariance + 0.03**2) / (variance_x + variance_y + 0.03**2)).mean())


def _halved(row: Recomputed) -> Recomputed:
    return Recomputed(f"DSSIM = (1 - SSIM) / 2, {row.name}", {over: (1 - value) / 2 for over, value in row.values.items()})


def _blackened(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Both frames black outside the mask; the windows there score 1."""
    outside = {}
    for view, frames in views.items():
        values = []
        for index in frames.frames:
            mask = masks[view](index)[..., None]
            values.append(similarity(frames.rendered(index) * mask, frames.truth(index) * mask, **GAUSSIAN))
        outside[view] = np.mean(values)
    return [Recomputed("Gaussian 11 x 11, valid positions, range 1, frames black outside the mask", mean_over_views(outside))]
