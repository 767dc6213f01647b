"""Conventions of PSNR, of L1 and root mean squared error, and of LPIPS."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.explain.conventions import (
    UNSCALED,
    FrameMeasure,
    Levels,
    Masks,
    Pooling,
    Preparation,
    Recomputed,
    Series,
    Values,
    Views,
    conventions,
    conventions_in_parts,
    crossed,
    frame_means,
    measured,
    over_views,
    prepared,
    remembered,
)
from ggvs_eval.contrib.explain.preparations import (
    CROPPED,
    FRAMINGS,
    GREY,
    HALVED,
    MASKINGS,
    MVSNERF_ON_LLFF,
    VIDEO_FORMS,
    both,
    colour_corrected,
    inside,
    luma,
    stretched,
    video_luma,
    without_border,
)

CEILING_DB = 100.0
LEVELS = {"0..255": 1, "0..1": 255}


def squared_error(first: Levels, second: Levels) -> float:
    """Mean squared error of two frames."""
    return float(np.square(np.subtract(first, second, dtype=np.float64)).mean())


def decibels(squared_error_255: Values | np.floating | float) -> Values:
    """PSNR on the scale 0..255, at most 100 dB."""
    return np.minimum(-10 * np.log10(np.maximum(squared_error_255, 1e-12) / 255**2), CEILING_DB)


PREPARATIONS: Mapping[str, Preparation] = {
    "RGB": lambda *pair: pair,
    "luma (BT.601) in 0..255": both(luma),
    "luma (BT.601) in 16..235, peak 255": both(video_luma),
    "luma (BT.601) in 16..235, peak 255, without a border of 4 px": both(
        lambda image: video_luma(without_border(image, border_px=4))
    ),
    **GREY,
    # Squared errors of these, mean over the channels, are sums over the channels.
    "RGB, squared errors summed over channels": both(lambda image: image * np.sqrt(3.0)),
    "RGB, range 2 of images in 0..1": both(lambda image: image / 2),
    "RGB, range of the true frame": stretched,
    "RGB before it was rounded down to 8 bit": lambda rendered, truth: (rendered + 0.5, truth),
    **{f"RGB, {name}": prepare for name, prepare in FRAMINGS.items()},
    "RGB without a border of 10 %": CROPPED,
    "RGB, both at 960 x 640, without a border of 10 % (MVSNeRF on LLFF)": MVSNERF_ON_LLFF,
    "RGB after the best affine colour map": colour_corrected,
}


@remembered
def _plane_errors(rendered: Image8, truth: Image8) -> dict[str, list[float]]:
    """Squared errors of Y, U and V in each form of video."""
    errors = {}
    for form, planes in VIDEO_FORMS.items():
        pairs = zip(planes(rendered), planes(truth), strict=True)
        errors[form] = [squared_error(*pair) for pair in pairs]
    return errors


def _of_samples(form: str, weights: Sequence[int], rendered: Image8, truth: Image8) -> float:
    return float(np.average(_plane_errors(rendered, truth)[form], weights=weights))


def _of_planes(form: str, rendered: Image8, truth: Image8) -> float:
    errors = np.array(_plane_errors(rendered, truth)[form])
    return float(np.average(decibels(errors), weights=(6, 1, 1)))


def _of_channels(rendered: Image8, truth: Image8) -> float:
    errors = np.square(np.subtract(rendered, truth, dtype=np.float64)).mean(axis=(0, 1))
    return float(decibels(errors).mean())


ERRORS: Mapping[str, FrameMeasure] = {
    **crossed({"": squared_error}, PREPARATIONS),
    **{
        f"{form}, {name}": partial(_of_samples, form, weights)
        for form in VIDEO_FORMS
        for name, weights in (("Y alone", (1, 0, 0)), ("all samples (ffmpeg's average)", (4, 1, 1)))
        if name != "Y alone" or "0..255" not in form  # which is a grey of 8 bit
    },
    # As scripts do that subtract arrays of uint8.
    "RGB, 8-bit differences and squares that wrap around": lambda rendered, truth: float(
        np.square(rendered - truth).mean()
    ),
    "RGB, 8-bit differences (rendered minus truth) that wrap around": lambda *pair: squared_error(
        pair[0] - pair[1], np.zeros(1)
    ),
    "RGB, 8-bit differences (truth minus rendered) that wrap around": lambda *pair: squared_error(
        pair[1] - pair[0], np.zeros(1)
    ),
}
DECIBELS: Mapping[str, FrameMeasure] = {
    "RGB, PSNR of each channel, then the mean (3DGS's log)": _of_channels,
    **{f"{form}, (6 Y + U + V) / 8": partial(_of_planes, form) for form in VIDEO_FORMS},
}
PSNR_POOLINGS = (
    over_views("mean of the frames' PSNR", lambda errors: decibels(errors).mean()),
    over_views(
        "PSNR of each view's mean squared error",
        lambda errors: decibels(errors.mean()),
        least_views=2,
    ),
    Pooling(
        "PSNR of the mean squared error",
        lambda views: float(decibels(np.concatenate(views).mean())),
        is_of_views=False,
    ),
)
OUR_PSNR = "RGB, mean of the frames' PSNR"


def psnr_conventions(views: Views, masks: Masks) -> list[Recomputed]:
    """PSNR over several kinds of pixels, averaged before or after the logarithm."""
    series = measured(views, {**ERRORS, **DECIBELS})
    errors = {name: series[name] for name in ERRORS}
    of_frames = {view: decibels(values) for view, values in errors["RGB"].items()}
    return [
        *conventions(errors, PSNR_POOLINGS, own_name=OUR_PSNR),
        *conventions(_masked_errors(views, masks), PSNR_POOLINGS),
        *conventions({name: series[name] for name in DECIBELS}),
        *conventions(
            {OUR_PSNR: of_frames},
            divisors={"10 log10 of peak over RMSE (half of it)": 2, "twice": 0.5},
        ),
        *conventions_in_parts({OUR_PSNR: of_frames}),
    ]


def _masked_errors(views: Views, masks: Masks) -> Series:
    """Return the squared errors of the pixels inside the masks, and of frames changed by them."""
    preparations = {"pixels inside the mask": inside, **MASKINGS}
    del preparations["frames white outside the mask"]  # whose errors are those of black ones
    errors = dict(measured(views, crossed({"": squared_error}, preparations), masks))
    if errors:
        pixels, _, rectangle = errors.values()
        if all(np.array_equal(pixels[view], rectangle[view]) for view in pixels):
            del errors["the rectangle around the mask"]
        summed = {
            f"{name}, squared errors summed over channels": of_views
            for name, of_views in errors.items()
        }
        errors |= {
            name: {view: 3 * values for view, values in of_views.items()}
            for name, of_views in summed.items()
        }
    return errors


def masked_rows(
    views: Views,
    masks: Masks,
    measures: Mapping[str, FrameMeasure],
    divisors: Mapping[str, float] = UNSCALED,
) -> list[Recomputed]:
    """Measures of frames with their masks; none unless every view has them."""
    if not views.keys() <= masks.keys():
        return []
    return conventions(measured(views, measures, masks), divisors=divisors)


OUR_L1 = "mean over pixels and channels"


def absolute(rendered: Levels, truth: Levels) -> float:
    """Mean absolute error of two frames, in levels."""
    return float(np.abs(rendered.astype(np.float64) - truth).mean())


ABSOLUTE: Mapping[str, FrameMeasure] = {
    OUR_L1: absolute,
    "sum over channels, mean over pixels": lambda *pair: 3 * absolute(*pair),
    **crossed({"": absolute}, {"without a border of 10 %": CROPPED, **GREY, **FRAMINGS}),
}
RMSE_POOLINGS = (
    over_views(
        "mean of the frames' root mean squared error (RMSE)",
        lambda errors: np.sqrt(errors).mean(),
    ),
    Pooling(
        "root of the mean squared error of all frames (RMSE)",
        lambda views: np.sqrt(np.concatenate(views).mean()),
    ),
)


def error_conventions(views: Views, masks: Masks) -> list[Recomputed]:
    """Return the mean absolute error and root mean squared error, in levels and in 0..1."""
    squared = {"": squared_error, **crossed({"": squared_error}, GREY)}
    return [
        *frame_means(views, ABSOLUTE, OUR_L1, divisors=LEVELS),
        *conventions(measured(views, squared), RMSE_POOLINGS, LEVELS),
        *masked_rows(views, masks, crossed({OUR_L1: absolute}, MASKINGS), LEVELS),
    ]


def rmse_conventions(views: Views, masks: Masks) -> list[Recomputed]:
    """Return the same; none is this tool's, which measures no RMSE."""
    return [replace(row, is_ours=False) for row in error_conventions(views, masks)]


OUR_LPIPS = "VGG, inputs in [-1, 1]"


def lpips_conventions(views: Views, masks: Masks) -> list[Recomputed]:
    """LPIPS v0.1 on either network, also with inputs left in [0, 1], which it was not
    trained on.
    """
    from ggvs_eval.metrics.image.lpips import lpips

    def unscaled(image: Image8) -> NDArray[np.float32]:
        # `lpips` maps this to [0, 1] where it expects [-1, 1].
        return np.asarray((image.astype(np.float32) / 255 + 1) / 2, np.float32)

    vgg, alex = partial(lpips, net="vgg"), partial(lpips, net="alex")
    trained: dict[str, FrameMeasure] = {OUR_LPIPS: vgg, "AlexNet, inputs in [-1, 1]": alex}
    measures = {
        **trained,
        "VGG, inputs in [0, 1]": prepared(vgg, both(unscaled)),
        "VGG, inputs in [-1, 1], both at half size": prepared(vgg, HALVED),
        "AlexNet, inputs in [0, 1]": prepared(alex, both(unscaled)),
    }
    return [
        *frame_means(views, measures, OUR_LPIPS, trained),
        *masked_rows(views, masks, crossed(trained, MASKINGS)),
    ]
