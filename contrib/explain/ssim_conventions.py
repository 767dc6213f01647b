"""Conventions of SSIM (window, border, data range, covariance, colour, size, scales) and of metrics over time and views.

Dissimilarities are one minus SSIM or half of it; TCC is an SSIM of changes; SDT and SDV are spreads over time and views.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from math import prod
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.explain.frame_conventions import (
    ALL_VIEWS,
    BT601,
    BT709,
    FRAMINGS,
    VIDEO_FORMS,
    FrameMeasure,
    Levels,
    MaskReader,
    Preparation,
    Recomputed,
    as_mvsnerf,
    changes,
    cropped,
    frame_means,
    grey,
    masked_rows,
    mean_over_views,
    view_pairs,
)
from ggvs_eval.errors import MetricError
from ggvs_eval.metric_choices import StedPairing
from ggvs_eval.metrics.image.ms_ssim import SMALLEST_PX, ms_ssim
from ggvs_eval.metrics.image.ssim import ssim_map, ssim_variant
from ggvs_eval.metrics.time import strred
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames

GAUSSIAN: dict[str, Any] = {"side": 11, "sigma": 1.5, "unbiased": False}
OUR_SSIM = "Gaussian 11 x 11, valid positions, range 1"
UNIFORM_RANGE_1 = "uniform 7 x 7, range 1 (scikit-image on uint8)"
UNIFORM_11 = "uniform 11 x 11, range 1 (scikit-image, win_size 11)"
ZERO_PADDED = "Gaussian 11 x 11, zero-padded, range 1 (3DGS)"
MULTI_SCALE = "MS-SSIM, five scales, Gaussian 11 x 11 (pytorch-msssim)"
UNIFORM_RANGE_2 = "uniform 7 x 7, range 2 (scikit-image on float, no range given; EasyVolcap)"
OUR_TCC = "Gaussian 11 x 11, valid positions, range 1, each channel cut off at 0"
DIVISORS = {"ddof 1": 1, "ddof 0": 0}
LUMAS = {"luma BT.601": np.array(strred.LUMA_WEIGHTS), "luma BT.709": BT709}
SCALES = {"0..255": 1.0, "0..1": 1.0 / 255}
OURS = ("disjoint pairs", "mean x mean", "luma BT.601", "0..255")
PAIRINGS = {"disjoint": "disjoint pairs", "consecutive": "consecutive pairs"}
STRIP_ROWS = 32  # so that the planes in between stay in cache


def ssim_conventions(
    views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader], ours: tuple[str, ...] = (OUR_SSIM,)
) -> list[Recomputed]:
    """SSIM as scikit-image, kornia and the code bases of this field compute it; `ours` are those by this tool."""
    shortest_px = min(min(view.truth(view.frames[0]).shape[:2]) for view in views.values())
    is_boxed = _box_side(shortest_px) > 1
    measures = {name: measure for name, measure in frame_measures().items() if is_boxed or BOXED not in name}
    if shortest_px >= SMALLEST_PX:
        measures[MULTI_SCALE] = ms_ssim
    plain = (OUR_SSIM, UNIFORM_RANGE_1, UNIFORM_RANGE_2, UNIFORM_11, MULTI_SCALE)
    rows = frame_means(views, measures, OUR_SSIM, (OUR_SSIM, ZERO_PADDED, UNIFORM_RANGE_1))
    rows += [_dissimilarity(row, divisor) for divisor in (1, 2) for row in rows if row.name in plain]
    rows += _inside(views, masks) if all(view in masks for view in views) else []
    rows += masked_rows(views, masks, {name: measures[name] for name in (OUR_SSIM, UNIFORM_RANGE_1)})
    return [replace(row, is_ours=row.name in ours) for row in rows]


DSSIM = "DSSIM = (1 - SSIM) / 2"
dssim_conventions = partial(ssim_conventions, ours=(f"{DSSIM}, {UNIFORM_RANGE_1}", f"{DSSIM}, {UNIFORM_RANGE_2}"))
ms_ssim_conventions = partial(ssim_conventions, ours=(MULTI_SCALE,))


def frame_measures() -> dict[str, FrameMeasure]:
    """Return name -> SSIM of two uint8 frames."""
    measures: dict[str, FrameMeasure] = {
        OUR_SSIM: partial(similarity, **GAUSSIAN),
        "Gaussian 11 x 11, valid positions, range 2": partial(similarity, data_range=2.0, **GAUSSIAN),
        "Gaussian 11 x 11, valid positions, range of the true frame": partial(similarity, data_range=None, **GAUSSIAN),
        "Gaussian 11 x 11, sample covariance, range 1": partial(similarity, **{**GAUSSIAN, "unbiased": True}),
        ZERO_PADDED: partial(ssim_variant, name="gaussian-zero"),
        "Gaussian 11 x 11, valid positions, range 1, luma": partial(similarity, luma=True, **GAUSSIAN),
        UNIFORM_RANGE_1: similarity,
        UNIFORM_RANGE_2: partial(similarity, data_range=2.0),
        "uniform 7 x 7, range 255 on images in 0..1": partial(similarity, data_range=255.0),
        "uniform 7 x 7, range of the true frame": partial(similarity, data_range=None),
        "uniform 7 x 7, population covariance, range 1": partial(similarity, unbiased=False),
        "uniform 7 x 7, range 1, luma": partial(similarity, luma=True),
        UNIFORM_11: partial(similarity, side=11),
        "uniform 11 x 11, range 2": partial(similarity, side=11, data_range=2.0),
        "uniform 11 x 11, population covariance, range 1": partial(similarity, side=11, unbiased=False),
        "uniform 7 x 7, range 1, without a border of 10 % (ENeRF, later code)": lambda *pair: similarity(*cropped(*pair)),
        "uniform 7 x 7, range 2, without a border of 10 % (ENeRF as published)": partial(_prepared, cropped, data_range=2.0),
        "uniform 7 x 7, range 2, both at 960 x 640, without a border of 10 % (MVSNeRF on LLFF)": partial(
            _prepared, as_mvsnerf, data_range=2.0
        ),
    }
    sized: dict[str, FrameMeasure] = {
        f"{window}, {size}": partial(_prepared, prepare, **options)
        for window, options in {OUR_SSIM: GAUSSIAN, "uniform 7 x 7, range 1": {}}.items()
        for size, prepare in PREPARATIONS.items()
    }
    windows: dict[str, FrameMeasure] = {
        f"Gaussian {side} x {side}, {border}, range 1{of}": partial(similarity, **{**GAUSSIAN, "side": side, "border": code})
        for side in (3, 5, 7, 9, 11)
        for (border, of), code in BORDERS.items()
        if (border, side) not in (("zero-padded", 11), ("valid positions", 11))
    }
    blocks: dict[str, FrameMeasure] = {
        f"blocks of 8 x 8 in whole numbers (ffmpeg), {form}": partial(_block_similarity, planes)
        for form, planes in {"RGB": lambda image: list(np.moveaxis(image, -1, 0)), **VIDEO_FORMS}.items()
    }
    return measures | sized | windows | blocks


BORDERS = {
    ("reflect-padded", " (kornia)"): cv2.BORDER_REFLECT_101,
    ("zero-padded", ""): cv2.BORDER_CONSTANT,
    ("valid positions", ""): None,
}


def _prepared(prepare: Preparation, rendered: Image8, truth: Image8, **options: Any) -> float:
    return similarity(*prepare(rendered, truth), **options)


BOXED = "after box averages"
PREPARATIONS: Mapping[str, Preparation] = {
    "grey of 8 bit": lambda rendered, truth: (grey(rendered), grey(truth)),
    **FRAMINGS,
    f"{BOXED} (MATLAB's ssim.m, piq)": lambda *pair: (_averaged_boxes(pair[0]), _averaged_boxes(pair[1])),
    f"luma {BOXED} (MATLAB's ssim.m, piq)": lambda *pair: tuple(_averaged_boxes(image @ BT601) for image in pair),
}


def _box_side(shortest_px: int) -> int:
    return max(round(shortest_px / 256), 1)


def _averaged_boxes(image: Levels) -> Levels:
    """Return the means of N x N pixels, unrounded: N is the shorter side over 256, rounded; the rest is cut off."""
    side = _box_side(min(image.shape[:2]))
    rows, columns = (size // side for size in image.shape[:2])
    boxes = image[: rows * side, : columns * side].reshape(rows, side, columns, side, *image.shape[2:])
    return boxes.mean(axis=(1, 3))


def similarity(
    rendered: Levels, truth: Levels, data_range: float | None = 1.0, luma: bool = False, unbiased: bool = True, **window: Any
) -> float:
    """SSIM of two frames, (H, W, 3) or (H, W), as scikit-image computes it where no border is given.

    Args:
        rendered: on the scale 0..255.
        data_range: where images are taken to 0..1; None for the range of the true frame's levels.
        unbiased: whether variances are divided by N - 1.
        window: arguments of `_moments`.
    """
    strips, levels = _moments(rendered, truth, luma, **window)
    white = (levels if data_range is None else data_range) or 1.0
    samples = window.get("side", 7) ** 2
    small, large = (0.01 * white) ** 2, (0.03 * white) ** 2 * (1 - 1 / samples if unbiased else 1)
    total = 0.0
    for squares, product, variances, covariance in strips:
        scores = (product + small) * (covariance + large)
        scores /= (squares + small) * (variances + large)
        total += float(scores.sum())
    return total / sum(strip[0].size for strip in strips)


def _kept(compute: Callable[..., tuple[Any, ...]]) -> Callable[..., tuple[Any, ...]]:
    """Return a function of two frames that keeps its last result: many conventions differ in what they make of it alone."""
    last: dict[Any, Any] = {}

    def again(rendered: Levels, truth: Levels, *args: Any, **options: Any) -> tuple[Any, ...]:
        key = (id(rendered), id(truth), args, *options.items())
        if key not in last:
            last.clear()
            last[key] = compute(rendered, truth, *args, **options), rendered, truth  # which therefore keep their ids
        return last[key][0]

    return again


@_kept
def _moments(
    rendered: Levels, truth: Levels, luma: bool, side: int = 7, sigma: float = 0.0, border: int | None = None
) -> tuple[Any, ...]:
    """Return what SSIM is made of, of each window of two frames in 0..1, and the range of the true frame's levels.

    Args:
        sigma: of a Gaussian window; 0 for a uniform one.
        border: of OpenCV, for windows at every pixel as kornia (reflected) and pytorch-ssim (zeros) have them; None for windows
            inside the frame alone.

    Returns:
        Strips of squares x^2 + y^2 and product 2 x y of the means, sum of the variances, and twice the covariance.
    """
    taps = cv2.getGaussianKernel(side, sigma) if sigma else np.full(side, 1 / side)
    blur = partial(cv2.sepFilter2D, ddepth=-1, kernelX=taps, kernelY=taps)
    first, second = (image @ BT601 if luma else image for image in (rendered, truth))
    levels = (float(second.max()) - float(second.min())) / 255
    half = side // 2
    if border is not None:
        first, second = (cv2.copyMakeBorder(image, half, half, half, half, border) for image in (first, second))
    if min(first.shape[:2]) < side:
        raise MetricError(f"SSIM: wanted frames of at least {side} x {side} pixels, its window; got {truth.shape[:2]}")
    strips = []
    for start in range(0, len(first) - 2 * half, STRIP_ROWS):
        x, y = (image[start : start + STRIP_ROWS + 2 * half] / 255.0 for image in (first, second))
        means = (blur(plane)[half:-half, half:-half] for plane in (x, y, x * x + y * y, 2 * x * y))
        mean_x, mean_y, energy, twice = means
        squares, product = mean_x * mean_x + mean_y * mean_y, 2 * mean_x * mean_y
        strips.append((squares, product, energy - squares, twice - product))
    return strips, levels


def _block_similarity(planes: Callable[[Image8], list[Levels]], rendered: Image8, truth: Image8) -> float:
    """Return ffmpeg's ``All``: SSIM of 8 x 8 blocks at every fourth pixel, planes weighted by their size (vf_ssim.c)."""
    small, large = int(0.01**2 * 255**2 * 64 + 0.5), int(0.03**2 * 255**2 * 64 * 63 + 0.5)
    scores, sizes = [], []
    for x, y in zip(planes(rendered), planes(truth), strict=True):
        x, y = (np.asarray(plane, dtype=np.int64) for plane in (x, y))
        sum_x, sum_y, squares, products = (_block_sums(each) for each in (x, y, x * x + y * y, x * y))
        variance, covariance = squares * 64 - sum_x**2 - sum_y**2, products * 64 - sum_x * sum_y
        above = (2 * sum_x * sum_y + small).astype(np.float64) * (2 * covariance + large)
        scores.append(float((above / ((sum_x**2 + sum_y**2 + small).astype(np.float64) * (variance + large))).mean()))
        sizes.append(prod(x.shape))
    return float(np.average(scores, weights=sizes))


def _block_sums(plane: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sums over blocks of 8 x 8 at every fourth pixel."""
    rows, columns = plane.shape[0] // 4, plane.shape[1] // 4
    quarters = plane[: rows * 4, : columns * 4].reshape(rows, 4, columns, 4).sum(axis=(1, 3))
    return quarters[:-1, :-1] + quarters[1:, :-1] + quarters[:-1, 1:] + quarters[1:, 1:]


def _dissimilarity(row: Recomputed, divisor: int) -> Recomputed:
    formula = "1 - SSIM" if divisor == 1 else DSSIM
    return Recomputed(f"{formula}, {row.name}", {over: (1 - value) / divisor for over, value in row.values.items()})


def _inside(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Return the mean over the windows whose middle is inside the masks."""
    inside: dict[str, dict[str, float]] = {}
    for variant in ("gaussian-valid", "gaussian-zero"):
        for view, frames in views.items():
            values = []
            for index in frames.frames:
                scores = ssim_map(frames.rendered(index), frames.truth(index), variant)
                margin = (len(frames.truth(index)) - len(scores)) // 2
                chosen = scores[masks[view](index)[margin : margin + scores.shape[0], margin : margin + scores.shape[1]]]
                values.append(float(chosen.mean(dtype=np.float64)) if chosen.size else 1.0)
            inside.setdefault(variant, {})[view] = float(np.mean(values))
    names = {"gaussian-valid": OUR_SSIM, "gaussian-zero": ZERO_PADDED}
    return [Recomputed(f"{names[each]}, windows inside the mask", mean_over_views(values)) for each, values in inside.items()]


def tcc_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """SSIM of absolute changes, with several SSIMs and several changes."""
    by_view: dict[str, dict[str, float]] = {}
    for view, frames in views.items():
        rows = [_change_scores(*pair) for pair in changes(frames, cv2.absdiff)]
        wrapped = [similarity(*pair, **GAUSSIAN) for pair in changes(frames, lambda before, after: after - before)]
        if not rows:
            raise MetricError(f"TCC compares neighbouring frames: {len(frames.frames)} frame of {view}; needs 2")
        means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
        by_view[view] = means | {"differences of 8 bit that wrap around": float(np.mean(wrapped))}
    names = next(iter(by_view.values()))
    return [
        Recomputed(name, mean_over_views({view: values[name] for view, values in by_view.items()}), name == OUR_TCC)
        for name in names
    ]


def _change_scores(rendered: Image8, truth: Image8) -> dict[str, float]:
    """SSIM of two pictures of change, name -> value."""
    channels = [similarity(rendered[..., c], truth[..., c], **GAUSSIAN) for c in range(3)]
    largest = max(float(truth.max()), 1.0) / 255
    return {
        OUR_TCC: float(np.maximum(channels, 0).mean()),
        "Gaussian 11 x 11, valid positions, range 1, not cut off": float(np.mean(channels)),
        "Gaussian 11 x 11, zero-padded, range 1": ssim_variant(rendered, truth, "gaussian-zero"),
        "Gaussian 11 x 11, valid positions, range of the largest change": similarity(rendered, truth, largest, **GAUSSIAN),
        "Gaussian 11 x 11, valid positions, range 2": similarity(rendered, truth, 2.0, **GAUSSIAN),
        "uniform 7 x 7, range 1": similarity(rendered, truth),
        "uniform 7 x 7, range 2": similarity(rendered, truth, 2.0),
        "mean of the channels' changes": similarity(rendered.mean(axis=-1), truth.mean(axis=-1), **GAUSSIAN),
    }


def sdt_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Return the standard deviation of L1 over time: candidates for the errors, the order and the divisor."""
    errors = _errors(views)
    if min(len(values) for values in errors.values()) < 2:
        raise MetricError("SDT is a spread over frames: a view has 1; needs 2")
    rows: list[Recomputed] = []
    for divisor, ddof in DIVISORS.items():
        spreads = mean_over_views({view: values.std(ddof=ddof) for view, values in errors.items()})
        rows += _in_units(f"mean over the views of each one's spread over time, {divisor}", spreads, ours=ddof == 1)
        if len(errors) > 1:
            pooled = float(np.concatenate(list(errors.values())).std(ddof=ddof))
            rows += _in_units(f"spread of all frames of all views together, {divisor}", {ALL_VIEWS: pooled})
            if _is_table(errors):
                together = float(np.stack(list(errors.values())).mean(axis=0).std(ddof=ddof))
                rows += _in_units(f"spread over time of the mean over the views, {divisor}", {ALL_VIEWS: together})
    return rows


def sdv_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Return the standard deviation of L1 over views: candidates for the errors, the order and the divisor."""
    errors = _errors(views)
    if len(errors) < 2 or not _is_table(errors):
        raise MetricError(f"SDV is a spread over views with equal frames: {len(errors)} view; needs 2 of as many frames")
    table = np.stack(list(errors.values()))  # (views, frames)
    rows: list[Recomputed] = []
    for divisor, ddof in DIVISORS.items():
        kinds = {
            f"mean over time of the spread over the views, {divisor}": table.std(axis=0, ddof=ddof).mean(),
            f"spread over the views of the mean over time, {divisor}": table.mean(axis=1).std(ddof=ddof),
            f"spread of all frames of all views together, {divisor}": table.std(ddof=ddof),
        }
        for name, value in kinds.items():
            rows += _in_units(name, {ALL_VIEWS: float(value)}, ours=ddof == 1 and name.startswith("mean over time"))
    return rows


def _errors(views: Mapping[str, ViewFrames]) -> dict[str, NDArray[np.float64]]:
    """L1 of every frame on the scale 0..255, view -> (T,)."""
    return {
        view: np.array([np.abs(rendered.astype(np.float64) - truth).mean() for rendered, truth in view_pairs(frames)])
        for view, frames in views.items()
    }


def _is_table(errors: Mapping[str, NDArray[np.float64]]) -> bool:
    return len({len(values) for values in errors.values()}) == 1


def _in_units(name: str, values: Mapping[str, float], ours: bool = False) -> list[Recomputed]:
    """Return a spread on both scales."""
    scaled = {over: value / 255 for over, value in values.items()}
    return [Recomputed(f"{name}, L1 in 0..255", values, ours), Recomputed(f"{name}, L1 in 0..1", scaled)]


def sted_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """ST-RRED of each view under each choice, mean over the views."""
    values: dict[str, dict[str, float]] = {}
    ours = ", ".join(OURS)
    for view, frames in views.items():
        if len(frames.frames) < 2:
            raise MetricError(f"STED compares changes between frames: 1 frame of {view}; needs 2")
        for name, value in _view_values(frames).items():
            values.setdefault(name, {})[view] = value
    return [Recomputed(name, mean_over_views(by_view), name == ours) for name, by_view in values.items()]


def _view_values(view: ViewFrames) -> dict[str, float]:
    """Return the name of the convention -> value of one view; only the bands of the frames are kept."""
    values: dict[str, float] = {}
    bands = {name: [] for name in LUMAS}  # type: dict[str, list[tuple[NDArray[np.float64], NDArray[np.float64]]]]
    for pair in view_pairs(view):
        for name, weights in LUMAS.items():
            rendered, truth = (strred.spatial_band(image @ weights) for image in pair)
            bands[name].append((rendered, truth))
    for luma, of_frames in bands.items():
        for scale, factor in SCALES.items():
            for pairing in get_args(StedPairing):
                pairs = _pair_differences([(factor * a, factor * b) for a, b in of_frames], pairing)
                for pooling, value in _pooled(pairs).items():
                    values[f"{PAIRINGS[pairing]}, {pooling}, {luma}, {scale}"] = value
    return values


def _pair_differences(bands: list[tuple[NDArray[np.float64], NDArray[np.float64]]], pairing: StedPairing) -> strred.StRred:
    """Return the differences of the pairs, from bands instead of frames so that each frame is filtered once."""
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
