"""Conventions of the metrics over time and views: TCC, SDT, SDV."""

from collections.abc import Mapping
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.ssim_variants import ssim_variant
from ggvs_eval.metrics.time import strred
from ggvs_eval.pipelines.inspection.renders.frame_conventions import BT709
from ggvs_eval.pipelines.inspection.renders.recompute import (
    ALL_VIEWS,
    MaskReader,
    Recomputed,
    changes,
    mean_over_views,
    view_pairs,
)
from ggvs_eval.pipelines.inspection.renders.ssim_conventions import GAUSSIAN, similarity
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames
from ggvs_eval.protocol import StedPairing

OUR_TCC = "Gaussian 11 x 11, valid positions, range 1, each channel cut off at 0"
DIVISORS = {"ddof 1": 1, "ddof 0": 0}
LUMAS = {"luma BT.601": np.array(strred.LUMA_WEIGHTS), "luma BT.709": BT709}
SCALES = {"0..255": 1.0, "0..1": 1.0 / 255}
OURS = ("disjoint pairs", "mean x mean", "luma BT.601", "0..255")
PAIRINGS = {"disjoint": "disjoint pairs", "consecutive": "consecutive pairs"}
Outputs = dict[tuple[str, str, str], dict[str, float]]


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
    """Standard deviation of L1 over time: of which errors, in which order, with which divisor."""
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
    """Standard deviation of L1 over views: of which errors, in which order, with which divisor."""
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
    """A spread on both scales."""
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
    """Name of the convention -> value of one view; only the bands of the frames are kept."""
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
    """Differences of the pairs, from bands instead of frames so that each frame is filtered once."""
    step = 2 if pairing == "disjoint" else 1
    differences = []
    for index in range(0, len(bands) - 1, step):
        rendered, truth = zip(bands[index], bands[index + 1], strict=True)
        references = (strred.reduced_references(*side, pairing) for side in (rendered, truth))
        differences.append(strred.pair_difference(*references))
    return strred.pool(differences)


def _pooled(result: strred.StRred) -> dict[str, float]:
    """Both outputs, pooled before and after the product."""
    spatial, temporal, single_spatial, single_temporal = result.pairs.T
    return {
        "mean x mean": result.strred,
        "mean of products": float((spatial * temporal).mean()),
        "single number (ssn), mean x mean": result.strred_ssn,
        "single number (ssn), mean of products": float((single_spatial * single_temporal).mean()),
    }
