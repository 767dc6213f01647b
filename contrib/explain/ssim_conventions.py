"""Conventions of SSIM (window, border, data range, covariance, colour, size, scales) and of metrics
over time and views.

Dissimilarities are one minus SSIM or half of it; TCC is an SSIM of changes; SDT and SDV are spreads
over time and views.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import pairwise
from math import prod
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.explain.conventions import (
    FrameMeasure,
    Levels,
    Masks,
    Pooling,
    Preparation,
    Recomputed,
    Values,
    Views,
    conventions,
    crossed,
    frame_means,
    measured,
    over_views,
    remembered,
    require_changes,
    series_of,
    view_pairs,
)
from ggvs_eval.contrib.explain.frame_conventions import absolute, masked_rows
from ggvs_eval.contrib.explain.preparations import (
    BT709,
    CROPPED,
    FRAMINGS,
    GREY,
    MASKINGS,
    MVSNERF_ON_LLFF,
    VIDEO_FORMS,
    both,
    luma,
)
from ggvs_eval.errors import MetricError
from ggvs_eval.metric_choices import StedPairing
from ggvs_eval.metrics.image.ms_ssim import SMALLEST_PX, WEIGHTS, ms_ssim
from ggvs_eval.metrics.image.ssim import ssim_map, ssim_variant
from ggvs_eval.metrics.time import strred
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames

GAUSSIAN_WINDOW: dict[str, Any] = {"side": 11, "sigma": 1.5}
GAUSSIAN: dict[str, Any] = {**GAUSSIAN_WINDOW, "unbiased": False}
OUR_SSIM = "Gaussian 11 x 11, valid positions, range 1"
UNIFORM_RANGE_1 = "uniform 7 x 7, range 1 (scikit-image on uint8)"
UNIFORM_11 = "uniform 11 x 11, range 1 (scikit-image, win_size 11)"
ZERO_PADDED = "Gaussian 11 x 11, zero-padded, range 1 (3DGS)"
MULTI_SCALE = "MS-SSIM, five scales, Gaussian 11 x 11 (pytorch-msssim)"
TORCH_MULTI_SCALE = (
    "MS-SSIM, five scales, Gaussian 11 x 11, coarsest border reflected (torchmetrics)"
)
UNIFORM_RANGE_2 = "uniform 7 x 7, range 2 (scikit-image on float, no range given; EasyVolcap)"
OUR_TCC = "Gaussian 11 x 11, valid positions, range 1, each channel cut off at 0"
DIVISORS = {"ddof 1": 1, "ddof 0": 0}
LUMAS = {"luma BT.601": np.array(strred.LUMA_WEIGHTS), "luma BT.709": BT709}
SCALES = {"0..255": 1.0, "0..1": 1.0 / 255}
OUR_STED = "disjoint pairs, mean x mean, luma BT.601, 0..255"
L1_LEVELS = {"L1 in 0..255": 1, "L1 in 0..1": 255}
STRIP_ROWS = 32  # so that the planes in between stay in cache


def ssim_conventions(
    views: Views, masks: Masks, own_names: tuple[str, ...] = (OUR_SSIM,)
) -> list[Recomputed]:
    """SSIM as scikit-image, kornia and the code bases of this field compute it.

    `own_names` are those by this tool.
    """
    shortest_px = min(min(view.truth(view.frames[0]).shape[:2]) for view in views.values())
    is_boxed = _box_side(shortest_px) > 1
    measures = {
        name: measure for name, measure in frame_measures().items() if is_boxed or BOXED not in name
    }
    if shortest_px >= SMALLEST_PX:
        measures |= {MULTI_SCALE: ms_ssim, TORCH_MULTI_SCALE: torch_ms_ssim}
    plain = (OUR_SSIM, ZERO_PADDED, UNIFORM_RANGE_1, UNIFORM_RANGE_2, UNIFORM_11, MULTI_SCALE)
    masked: dict[str, FrameMeasure] = {
        f"{OUR_SSIM}, windows inside the mask": partial(
            _inside, partial(ssim_map, name="gaussian-valid")
        ),
        f"{ZERO_PADDED}, windows inside the mask": partial(
            _inside, partial(ssim_map, name="gaussian-zero")
        ),
        **crossed({name: measures[name] for name in (OUR_SSIM, UNIFORM_RANGE_1)}, MASKINGS),
    }
    rows = frame_means(views, measures, OUR_SSIM, (OUR_SSIM, ZERO_PADDED, UNIFORM_RANGE_1))
    rows += [
        _dissimilarity(row, divisor) for divisor in (1, 2) for row in rows if row.name in plain
    ]
    rows += masked_rows(views, masks, masked)
    return [Recomputed(row.name, row.values, row.name in own_names) for row in rows]


DSSIM = "DSSIM = (1 - SSIM) / 2"
dssim_conventions = partial(
    ssim_conventions, own_names=(f"{DSSIM}, {UNIFORM_RANGE_1}", f"{DSSIM}, {UNIFORM_RANGE_2}")
)
ms_ssim_conventions = partial(ssim_conventions, own_names=(MULTI_SCALE,))
BOXED = "after box averages"
# Name -> options of `similarity`.
WINDOWS: Mapping[str, Mapping[str, Any]] = {
    OUR_SSIM: GAUSSIAN,
    "Gaussian 11 x 11, valid positions, range 2": {**GAUSSIAN, "data_range": 2.0},
    "Gaussian 11 x 11, valid positions, range of the true frame": {**GAUSSIAN, "data_range": None},
    "Gaussian 11 x 11, sample covariance, range 1": {**GAUSSIAN, "unbiased": True},
    ZERO_PADDED: {},
    "Gaussian 11 x 11, valid positions, range 1, luma": {**GAUSSIAN, "prepare": both(luma)},
    UNIFORM_RANGE_1: {},
    UNIFORM_RANGE_2: {"data_range": 2.0},
    "uniform 7 x 7, range 255 on images in 0..1": {"data_range": 255.0},
    "uniform 7 x 7, range 1 on images in 0..255": {"data_range": 1 / 255},
    "Gaussian 11 x 11, valid positions, range 1 on images in 0..255": {
        **GAUSSIAN,
        "data_range": 1 / 255,
    },
    **{
        f"uniform {side} x {side}, range 1 (scikit-image, win_size {side})": {"side": side}
        for side in (3, 5, 9)
    },
    "uniform 7 x 7, range of the true frame": {"data_range": None},
    "uniform 7 x 7, population covariance, range 1": {"unbiased": False},
    "uniform 7 x 7, range 1, luma": {"prepare": both(luma)},
    UNIFORM_11: {"side": 11},
    "uniform 11 x 11, range 2": {"side": 11, "data_range": 2.0},
    "uniform 11 x 11, population covariance, range 1": {"side": 11, "unbiased": False},
    "uniform 7 x 7, range 1, without a border of 10 % (ENeRF, later code)": {"prepare": CROPPED},
    "uniform 7 x 7, range 2, without a border of 10 % (ENeRF as published)": {
        "prepare": CROPPED,
        "data_range": 2.0,
    },
    "uniform 7 x 7, range 2, both at 960 x 640, without a border of 10 % (MVSNeRF on LLFF)": {
        "prepare": MVSNERF_ON_LLFF,
        "data_range": 2.0,
    },
}
BORDERS = {
    ("reflect-padded", " (kornia)"): cv2.BORDER_REFLECT_101,
    ("zero-padded", ""): cv2.BORDER_CONSTANT,
    ("valid positions", ""): None,
}
PREPARATIONS: Mapping[str, Preparation] = {
    **GREY,
    **FRAMINGS,
    f"{BOXED} (MATLAB's ssim.m, piq)": both(lambda image: _averaged_boxes(image)),
    f"luma {BOXED} (MATLAB's ssim.m, piq)": both(lambda image: _averaged_boxes(luma(image))),
}


def frame_measures() -> dict[str, FrameMeasure]:
    """Return name -> SSIM of two uint8 frames."""
    measures: dict[str, FrameMeasure] = {
        name: partial(similarity, **options) for name, options in WINDOWS.items()
    }
    measures[ZERO_PADDED] = partial(ssim_variant, name="gaussian-zero")
    sized: dict[str, FrameMeasure] = {
        OUR_SSIM: measures[OUR_SSIM],
        "uniform 7 x 7, range 1": similarity,
    }
    measures |= crossed(sized, PREPARATIONS)
    for side in (3, 5, 7, 9, 11):
        for (border, of_range), code in BORDERS.items():
            name = f"Gaussian {side} x {side}, {border}, range 1{of_range}"
            if name not in (OUR_SSIM, ZERO_PADDED.removesuffix(" (3DGS)")):
                measures[name] = partial(similarity, **{**GAUSSIAN, "side": side, "border": code})
    for form, planes in {
        "RGB": lambda image: list(np.moveaxis(image, -1, 0)),
        **VIDEO_FORMS,
    }.items():
        measures[f"blocks of 8 x 8 in whole numbers (ffmpeg), {form}"] = partial(
            _block_similarity, planes
        )
    return measures


def _box_side(shortest_px: int) -> int:
    return max(round(shortest_px / 256), 1)


def _averaged_boxes(image: Levels) -> Levels:
    """Return the means of N x N pixels, unrounded: N is the shorter side over 256, rounded.

    The rest is cut off.
    """
    side = _box_side(min(image.shape[:2]))
    rows, columns = (size // side for size in image.shape[:2])
    boxes = image[: rows * side, : columns * side].reshape(
        rows, side, columns, side, *image.shape[2:]
    )
    return boxes.mean(axis=(1, 3))


def torch_ms_ssim(rendered: Levels, truth: Levels) -> float:
    """MS-SSIM as TorchMetrics computes it.

    Each scale is one mean over channels, odd rows and columns are dropped, and the coarsest scale
    has windows at every pixel, its border reflected.
    """
    pair, product = (rendered.astype(np.float64), truth.astype(np.float64)), 1.0
    small, large = 0.01**2, 0.03**2
    for scale, weight in enumerate(WEIGHTS):
        scores = []
        is_last = scale == len(WEIGHTS) - 1
        border = cv2.BORDER_REFLECT_101 if is_last else None
        for squares, products, variances, covariance in _moments(
            *pair, **GAUSSIAN_WINDOW, border=border
        )[0]:
            contrast = (covariance + large) / (variances + large)
            scores.append(
                contrast * (products + small) / (squares + small) if is_last else contrast
            )
        product *= max(float(np.concatenate(scores).mean()), 0.0) ** weight
        pair = _halved(pair[0]), _halved(pair[1])
    return product


def _halved(image: Levels) -> Levels:
    rows, columns = (size // 2 for size in image.shape[:2])
    return image[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, -1).mean(axis=(1, 3))


def similarity(
    rendered: Levels,
    truth: Levels,
    data_range: float | None = 1.0,
    unbiased: bool = True,
    prepare: Preparation | None = None,
    **window: Any,
) -> float:
    """SSIM of two frames, (H, W, 3) or (H, W), as scikit-image computes it where no border is
    given.

    Args:
        rendered: on the scale 0..255.
        data_range: where images are taken to 0..1; None for the range of the true frame's levels.
        unbiased: whether variances are divided by N - 1.
        window: arguments of `_moments`.
    """
    if prepare is not None:
        rendered, truth = prepare(rendered, truth)
    strips, levels = _moments(rendered, truth, **window)
    white = (levels if data_range is None else data_range) or 1.0
    samples = window.get("side", 7) ** 2
    small, large = (0.01 * white) ** 2, (0.03 * white) ** 2 * (1 - 1 / samples if unbiased else 1)
    total = 0.0
    for squares, product, variances, covariance in strips:
        scores = (product + small) * (covariance + large)
        scores /= (squares + small) * (variances + large)
        total += float(scores.sum())
    return total / sum(strip[0].size for strip in strips)


@remembered
def _moments(
    rendered: Levels, truth: Levels, side: int = 7, sigma: float = 0.0, border: int | None = None
) -> tuple[Any, ...]:
    """Return what SSIM is made of, of each window of two frames in 0..1, and the range of the true
    frame's levels.

    Args:
        sigma: of a Gaussian window; 0 for a uniform one.
        border: of OpenCV, for windows at every pixel as kornia (reflected) and pytorch-ssim (zeros)
            have them; None for windows inside the frame alone.

    Returns:
        Strips of squares x^2 + y^2 and product 2 x y of the means, sum of the variances, and twice
        the covariance.
    """
    taps = cv2.getGaussianKernel(side, sigma) if sigma else np.full(side, 1 / side)
    blur = partial(cv2.sepFilter2D, ddepth=-1, kernelX=taps, kernelY=taps)
    first, second = rendered, truth
    levels = (float(second.max()) - float(second.min())) / 255
    half = side // 2
    if border is not None:
        first, second = (
            cv2.copyMakeBorder(image, half, half, half, half, border) for image in (first, second)
        )
    if min(first.shape[:2]) < side:
        raise MetricError(
            f"SSIM: wanted frames of at least {side} x {side} pixels, its window; got "
            f"{truth.shape[:2]}"
        )
    strips = []
    for start in range(0, len(first) - 2 * half, STRIP_ROWS):
        x, y = (image[start : start + STRIP_ROWS + 2 * half] / 255.0 for image in (first, second))
        means = (blur(plane)[half:-half, half:-half] for plane in (x, y, x * x + y * y, 2 * x * y))
        mean_x, mean_y, energy, twice = means
        squares, product = mean_x * mean_x + mean_y * mean_y, 2 * mean_x * mean_y
        strips.append((squares, product, energy - squares, twice - product))
    return strips, levels


def _block_similarity(
    planes: Callable[[Image8], list[Levels]], rendered: Image8, truth: Image8
) -> float:
    """Return ffmpeg's ``All``: SSIM of 8 x 8 blocks at every fourth pixel, planes weighted by their
    size (vf_ssim.c).
    """
    small, large = int(0.01**2 * 255**2 * 64 + 0.5), int(0.03**2 * 255**2 * 64 * 63 + 0.5)
    scores, sizes = [], []
    for x, y in zip(planes(rendered), planes(truth), strict=True):
        x, y = (np.asarray(plane, dtype=np.int64) for plane in (x, y))
        sum_x, sum_y, squares, products = (
            _block_sums(plane) for plane in (x, y, x * x + y * y, x * y)
        )
        variance, covariance = squares * 64 - sum_x**2 - sum_y**2, products * 64 - sum_x * sum_y
        above = (2 * sum_x * sum_y + small).astype(np.float64) * (2 * covariance + large)
        scores.append(
            float(
                (
                    above / ((sum_x**2 + sum_y**2 + small).astype(np.float64) * (variance + large))
                ).mean()
            )
        )
        sizes.append(prod(x.shape))
    return float(np.average(scores, weights=sizes))


def _block_sums(plane: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sums over blocks of 8 x 8 at every fourth pixel."""
    rows, columns = plane.shape[0] // 4, plane.shape[1] // 4
    quarters = plane[: rows * 4, : columns * 4].reshape(rows, 4, columns, 4).sum(axis=(1, 3))
    return quarters[:-1, :-1] + quarters[1:, :-1] + quarters[:-1, 1:] + quarters[1:, 1:]


def _dissimilarity(row: Recomputed, divisor: int) -> Recomputed:
    formula = "1 - SSIM" if divisor == 1 else DSSIM
    return Recomputed(
        f"{formula}, {row.name}",
        {over: (1 - value) / divisor for over, value in row.values.items()},
    )


def _inside(
    similarities: Callable[[Image8, Image8], Levels],
    rendered: Image8,
    truth: Image8,
    mask: NDArray[np.bool_],
) -> float:
    """Return the mean over the windows whose middle is inside the mask."""
    scores = similarities(rendered, truth)
    margin = (len(truth) - len(scores)) // 2
    middles = mask[margin : margin + scores.shape[0], margin : margin + scores.shape[1]]
    return float(scores[middles].mean(dtype=np.float64)) if middles.any() else 1.0


def tcc_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """SSIM of absolute changes, with several SSIMs and several changes."""
    require_changes(views, "TCC compares neighbouring frames")
    series = series_of({name: _change_scores(view) for name, view in views.items()})
    return conventions(series, own_name=OUR_TCC)


def _change_scores(view: ViewFrames) -> Iterator[dict[str, float]]:
    """SSIM of the pictures of change from each frame to the next."""
    for before, after in pairwise(view_pairs(view)):
        rendered, truth = (cv2.absdiff(*frames) for frames in zip(before, after, strict=True))
        wrapped, true_wrapped = (
            later - earlier for earlier, later in zip(before, after, strict=True)
        )
        channels = [similarity(rendered[..., c], truth[..., c], **GAUSSIAN) for c in range(3)]
        largest = max(float(truth.max()), 1.0) / 255
        yield {
            OUR_TCC: float(np.maximum(channels, 0).mean()),
            "Gaussian 11 x 11, valid positions, range 1, not cut off": float(np.mean(channels)),
            "Gaussian 11 x 11, zero-padded, range 1": ssim_variant(
                rendered, truth, "gaussian-zero"
            ),
            "Gaussian 11 x 11, valid positions, range of the largest change": similarity(
                rendered, truth, largest, **GAUSSIAN
            ),
            "Gaussian 11 x 11, valid positions, range 2": similarity(
                rendered, truth, 2.0, **GAUSSIAN
            ),
            "uniform 7 x 7, range 1": similarity(rendered, truth),
            "uniform 7 x 7, range 2": similarity(rendered, truth, 2.0),
            "mean of the channels' changes": similarity(
                rendered.mean(axis=-1), truth.mean(axis=-1), **GAUSSIAN
            ),
            "differences of 8 bit that wrap around": similarity(wrapped, true_wrapped, **GAUSSIAN),
        }


def sdt_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """Return the standard deviation of L1 over time: candidates for the errors, the order and the
    divisor.
    """
    errors = measured(views, {"": absolute})
    if min(len(view.frames) for view in views.values()) < 2:
        raise MetricError("SDT is a spread over frames: a view has 1; needs 2")
    poolings = []
    for divisor, ddof in DIVISORS.items():
        spread = partial(np.std, ddof=ddof)
        poolings += [
            over_views(f"mean over the views of each one's spread over time, {divisor}", spread),
            _of_all(
                f"spread of all frames of all views together, {divisor}", np.concatenate, spread
            ),
        ]
        if _is_table(views):
            mean = partial(np.mean, axis=0)
            poolings.append(
                _of_all(f"spread over time of the mean over the views, {divisor}", mean, spread)
            )
    own_name = "mean over the views of each one's spread over time, ddof 1, L1 in 0..255"
    return conventions(errors, poolings, L1_LEVELS, own_name)


def sdv_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """Return the standard deviation of L1 over views: candidates for the errors, the order and the
    divisor.
    """
    if len(views) < 2 or not _is_table(views):
        raise MetricError(
            f"SDV is a spread over views with equal frames: {len(views)} view; needs 2 of as many "
            f"frames"
        )
    poolings = []
    for divisor, ddof in DIVISORS.items():
        spread = partial(np.std, ddof=ddof)
        poolings += [
            _of_all(
                f"mean over time of the spread over the views, {divisor}",
                partial(spread, axis=0),
                np.mean,
            ),
            _of_all(
                f"spread over the views of the mean over time, {divisor}",
                partial(np.mean, axis=1),
                spread,
            ),
            _of_all(f"spread of all frames of all views together, {divisor}", np.stack, spread),
        ]
    ours = "mean over time of the spread over the views, ddof 1, L1 in 0..255"
    return conventions(measured(views, {"": absolute}), poolings, L1_LEVELS, ours)


def _of_all(name: str, join: Callable[..., Any], pool: Callable[..., Any]) -> Pooling:
    return Pooling(name, lambda views: pool(join(views)), is_of_views=False, least_views=2)


def _is_table(views: Views) -> bool:
    return len({len(view.frames) for view in views.values()}) == 1


def sted_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """ST-RRED of each view under each choice, mean over the views."""
    require_changes(views, "STED compares changes between frames")
    series = series_of({name: [_view_values(view)] for name, view in views.items()})
    return conventions(series, own_name=OUR_STED)


def _view_values(view: ViewFrames) -> dict[str, float]:
    """Return the name of the convention -> value of one view.

    Only the bands of the frames are kept.
    """
    values: dict[str, float] = {}
    bands: dict[str, list[tuple[Values, Values]]] = {name: [] for name in LUMAS}
    for pair in view_pairs(view):
        for name, weights in LUMAS.items():
            rendered, truth = (strred.spatial_band(image @ weights) for image in pair)
            bands[name].append((rendered, truth))
    for luma_name, of_frames in bands.items():
        for scale, factor in SCALES.items():
            for pairing in get_args(StedPairing):
                pairs = _pair_differences([(factor * a, factor * b) for a, b in of_frames], pairing)
                for pooling, value in _pooled(pairs).items():
                    values[f"{pairing} pairs, {pooling}, {luma_name}, {scale}"] = value
    return values


def _pair_differences(bands: list[tuple[Values, Values]], pairing: StedPairing) -> strred.StRred:
    """Return the differences of the pairs, from bands instead of frames so that each frame is
    filtered once.
    """
    step = 2 if pairing == "disjoint" else 1
    differences = []
    for index in range(0, len(bands) - 1, step):
        rendered, truth = zip(bands[index], bands[index + 1], strict=True)
        references = (strred.reduced_references(*side, pairing) for side in (rendered, truth))
        differences.append(strred.pair_difference(*references))
    return strred.pool(differences)


def _pooled(result: strred.StRred) -> dict[str, float]:
    """Return both outputs, pooled before and after the product."""
    spatial, temporal, single_spatial, single_temporal = result.pairs.T
    return {
        "mean x mean": result.strred,
        "mean of products": float((spatial * temporal).mean()),
        "single number (ssn), mean x mean": result.strred_ssn,
        "single number (ssn), mean of products": float((single_spatial * single_temporal).mean()),
    }
