"""Conventions of SSIM: window, border, data range, covariance, colour, size, scales; and dissimilarities."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.metrics.image.ms_ssim import SMALLEST_PX, ms_ssim
from ggvs_eval.metrics.image.ssim_variants import ssim_variant
from ggvs_eval.pipelines.inspection.renders.frame_conventions import BT601, at_llff_size, cropped, grey, half_truth, halved
from ggvs_eval.pipelines.inspection.renders.recompute import FrameMeasure, MaskReader, Recomputed, frame_means, mean_over_views
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames

Levels = NDArray[Any]
Preparation = Callable[[Image8, Image8], tuple[Levels, Levels]]
GAUSSIAN: dict[str, Any] = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
OUR_SSIM = "Gaussian 11 x 11, valid positions, range 1"
UNIFORM_RANGE_1 = "uniform 7 x 7, range 1 (scikit-image on uint8)"
UNIFORM_11 = "uniform 11 x 11, range 1 (scikit-image, win_size 11)"
MULTI_SCALE = "MS-SSIM, five scales, Gaussian 11 x 11 (pytorch-msssim)"
UNIFORM_RANGE_2 = "uniform 7 x 7, range 2 (scikit-image on float, no range given; EasyVolcap)"


def ssim_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """SSIM as scikit-image, kornia and the code bases of this field compute it."""
    measures = frame_measures()
    if all(min(view.truth(view.frames[0]).shape[:2]) >= SMALLEST_PX for view in views.values()):
        measures[MULTI_SCALE] = ms_ssim
    rows = frame_means(views, measures, OUR_SSIM)
    plain = [row for row in rows if row.name in (OUR_SSIM, UNIFORM_RANGE_1, UNIFORM_RANGE_2, UNIFORM_11, MULTI_SCALE)]
    rows += [_dissimilarity(row, divisor) for divisor in (1, 2) for row in plain]
    return rows + _blackened(views, masks) if all(view in masks for view in views) else rows


def frame_measures() -> dict[str, FrameMeasure]:
    """Name -> SSIM of two uint8 frames."""
    measures: dict[str, FrameMeasure] = {
        OUR_SSIM: partial(similarity, **GAUSSIAN),
        "Gaussian 11 x 11, valid positions, range 2": partial(similarity, data_range=2.0, **GAUSSIAN),
        "Gaussian 11 x 11, valid positions, range of the true frame": partial(similarity, data_range=None, **GAUSSIAN),
        "Gaussian 11 x 11, sample covariance, range 1": partial(similarity, **{**GAUSSIAN, "use_sample_covariance": True}),
        "Gaussian 11 x 11, zero-padded, range 1 (3DGS)": partial(ssim_variant, name="gaussian-zero"),
        "Gaussian 11 x 11, reflect-padded, range 1 (kornia)": reflected,
        "Gaussian 11 x 11, valid positions, range 1, luma": partial(similarity, luma=True, **GAUSSIAN),
        UNIFORM_RANGE_1: similarity,
        UNIFORM_RANGE_2: partial(similarity, data_range=2.0),
        "uniform 7 x 7, range 255 on images in 0..1": partial(similarity, data_range=255.0),
        "uniform 7 x 7, range of the true frame": partial(similarity, data_range=None),
        "uniform 7 x 7, population covariance, range 1": partial(similarity, use_sample_covariance=False),
        "uniform 7 x 7, range 1, luma": partial(similarity, luma=True),
        UNIFORM_11: partial(similarity, win_size=11),
        "uniform 11 x 11, population covariance, range 1": partial(similarity, win_size=11, use_sample_covariance=False),
        "uniform 7 x 7, range 1, without a border of 10 % (ENeRF, later code)": lambda *pair: similarity(*cropped(*pair)),
        "uniform 7 x 7, range 2, without a border of 10 % (ENeRF as published)": partial(_prepared, cropped, data_range=2.0),
        "uniform 7 x 7, range 2, both at 960 x 640, without a border of 10 % (MVSNeRF on LLFF)": partial(
            _prepared, lambda *pair: cropped(*at_llff_size(*pair)), data_range=2.0
        ),
    }
    sized: dict[str, FrameMeasure] = {
        f"{window}, {size}": partial(_prepared, prepare, **options)
        for window, options in {OUR_SSIM: GAUSSIAN, "uniform 7 x 7, range 1": {}}.items()
        for size, prepare in PREPARATIONS.items()
    }
    return measures | sized


def _prepared(prepare: Preparation, rendered: Image8, truth: Image8, **options: Any) -> float:
    return similarity(*prepare(rendered, truth), **options)


PREPARATIONS: Mapping[str, Preparation] = {
    "grey of 8 bit": lambda rendered, truth: (grey(rendered), grey(truth)),
    "both at half size": halved,
    "truth of half size enlarged": half_truth,
    "both at 960 x 640": at_llff_size,
}


def similarity(rendered: Levels, truth: Levels, data_range: float | None = 1.0, luma: bool = False, **options: Any) -> float:
    """scikit-image's SSIM of two frames, (H, W, 3) or (H, W).

    Args:
        rendered: on the scale 0..255.
        data_range: where images are taken to 0..1; None for the range of the true frame's levels.
    """
    from skimage.metrics import structural_similarity

    first, second = (image @ BT601 / 255 if luma else image / 255 for image in (rendered, truth))
    levels = float(second.max() - second.min()) if data_range is None else data_range
    axis = 2 if second.ndim == 3 else None
    return float(structural_similarity(first, second, data_range=levels or 1.0, channel_axis=axis, **options))


def reflected(rendered: Image8, truth: Image8) -> float:
    """Mean of kornia's SSIM map of two frames, (H, W, 3): a Gaussian window at every pixel, the image reflected at its border."""
    import torch
    from kornia.metrics import ssim

    first, second = (torch.from_numpy(image / 255).permute(2, 0, 1)[None] for image in (rendered, truth))
    return float(ssim(first, second, window_size=11, padding="same").mean())


def _dissimilarity(row: Recomputed, divisor: int) -> Recomputed:
    formula = "1 - SSIM" if divisor == 1 else "DSSIM = (1 - SSIM) / 2"
    is_ours = divisor == 2 and row.name in (UNIFORM_RANGE_1, UNIFORM_RANGE_2)  # D-SSIM 1 and 2
    return Recomputed(f"{formula}, {row.name}", {over: (1 - value) / divisor for over, value in row.values.items()}, is_ours)


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
