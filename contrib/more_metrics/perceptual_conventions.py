"""Conventions of IV-PSNR, DISTS, FLIP, VMAF and ColorVideoVDP: colour spaces, sizes, viewing
conditions, models, averages.
"""

from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.explain.conventions import (
    FrameMeasure,
    Masks,
    Recomputed,
    Values,
    Views,
    conventions,
    frame_means,
    over_views,
    prepared,
    view_pairs,
)
from ggvs_eval.contrib.explain.preparations import BT601, BT709, HALVED, both, ycbcr
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels

OUR_IV_PSNR = "YCbCr of BT.709 without headroom, full chroma"
OUR_DISTS = "frames at their own size"
OUR_FLIP = "mean, 67 pixels per degree"
OUR_VMAF = "vmaf_v0.6.1, BT.709, mean over frames"
OUR_VDP = "standard_4k, 30 frames per second"
SCRIPT_SIDE_PX = 256


def iv_psnr_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """IV-PSNR on the YCbCr that a video file would hold, and the PSNR of YCbCr that its program
    prints as well.
    """
    from ggvs_eval.contrib.more_metrics.iv_psnr import iv_psnr, psnr_ycbcr

    def of_video(matrix: NDArray[np.float64], headroom: bool, chroma: int) -> FrameMeasure:
        colours = both(lambda image: _ycbcr(image, matrix, headroom, chroma))
        return prepared(partial(iv_psnr, colours="ycbcr"), colours)

    measures: dict[str, FrameMeasure] = {
        OUR_IV_PSNR: iv_psnr,
        "YCbCr of BT.601 without headroom, full chroma": of_video(BT601, headroom=False, chroma=1),
        "YCbCr of BT.709 in 16..235, full chroma": of_video(BT709, headroom=True, chroma=1),
        "YCbCr of BT.709 in 16..235, chroma 4:2:0 (video)": of_video(
            BT709, headroom=True, chroma=2
        ),
        "YCbCr of BT.601 in 16..235, chroma 4:2:0 (video)": of_video(
            BT601, headroom=True, chroma=2
        ),
        "PSNR of YCbCr 4:1:1, BT.709, without tolerance": psnr_ycbcr,
    }
    return frame_means(views, measures, OUR_IV_PSNR)


def _ycbcr(image: Image8, matrix: NDArray[np.float64], headroom: bool, chroma: int) -> Image8:
    """8-bit YCbCr, (H, W, 3); chroma averaged over N pixels a side and repeated."""
    levels = ycbcr(image, matrix, headroom)
    planes = [levels[..., 0], *(_coarse(levels[..., channel], chroma) for channel in (1, 2))]
    return round_levels(np.stack(planes, axis=-1))


def _coarse(plane: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    height, width = plane.shape
    small = cv2.resize(
        plane, (max(width // side, 1), max(height // side, 1)), interpolation=cv2.INTER_AREA
    )
    return (
        plane
        if side == 1
        else np.asarray(
            cv2.resize(np.rint(small), (width, height), interpolation=cv2.INTER_NEAREST)
        )
    )


def dists_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """DISTS at the frames' own size, and after the shrinking of its authors' script."""
    from ggvs_eval.contrib.more_metrics.dists import dists

    measures: dict[str, FrameMeasure] = {
        OUR_DISTS: dists,
        "frames shrunk to 256 pixels at the shorter side (authors' script)": prepared(
            dists, both(_shrunk)
        ),
        "both at half size": prepared(dists, HALVED),
    }
    return frame_means(views, measures, OUR_DISTS)


def _shrunk(image: Image8) -> Image8:
    """Return the frame as Pillow shrinks it, bilinear, where its shorter side is longer than that
    of the script.
    """
    from PIL import Image

    height, width = image.shape[:2]
    factor = SCRIPT_SIDE_PX / min(height, width)
    if factor >= 1:
        return image
    size = int(width * factor), int(height * factor)
    return np.asarray(
        Image.fromarray(image).resize(size, Image.Resampling.BILINEAR), dtype=np.uint8
    )


def flip_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """FLIP's mean and median, and its mean under other viewing conditions."""
    from ggvs_eval.contrib.more_metrics.flip import flip, flip_map

    measures: dict[str, FrameMeasure] = {
        OUR_FLIP: flip,
        "median, 67 pixels per degree": lambda *pair: float(np.median(flip_map(*pair))),
        "mean, 33.5 pixels per degree (a full HD monitor)": lambda rendered, truth: float(
            flip_map(rendered, truth, 33.51).mean()
        ),
        "mean, 67 pixels per degree, both at half size": prepared(flip, HALVED),
    }
    return frame_means(views, measures, OUR_FLIP)


def vmaf_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """VMAF of each model that this ffmpeg has and either matrix, its frames averaged in
    three ways.
    """
    from ggvs_eval.contrib.more_metrics.vmaf import MODEL, MODEL_V1, vmaf

    averages = (
        over_views("mean over frames"),
        over_views("harmonic mean over frames", lambda values: 1 / np.mean(1 / (values + 1)) - 1),
        over_views("worst frame", np.min),
    )
    series: dict[str, dict[str, Values]] = {}
    for model in (MODEL, f"{MODEL}neg", MODEL_V1):
        for matrix in ("bt709", "bt601"):
            try:
                values = {
                    name: np.array(vmaf(view_pairs(view), model, matrix))
                    for name, view in views.items()
                }
            except MetricError:
                if model == MODEL:
                    raise
                continue  # an older libvmaf, or frames too small for it
            series[f"{model}, {matrix.replace('bt', 'BT.')}"] = values
    return conventions(series, averages, own_name=OUR_VMAF)


def vdp_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """ColorVideoVDP on two displays and at three rates."""
    from ggvs_eval.contrib.more_metrics.colour_video_vdp import colour_video_vdp

    series: dict[str, dict[str, Values]] = {}
    for display, rate in (
        ("standard_4k", 30),
        ("standard_fhd", 30),
        ("standard_4k", 24),
        ("standard_4k", 60),
    ):
        name = f"{display}, {rate} frames per second"
        series[name] = {
            view: np.array(
                [colour_video_vdp(view_pairs(frames), display=display, frames_per_second=rate)]
            )
            for view, frames in views.items()
        }
    return conventions(series, own_name=OUR_VDP)
