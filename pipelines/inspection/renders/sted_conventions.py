"""Conventions of STED: which frames are paired, how pairs are pooled, which output, which luma on which scale."""

from collections.abc import Mapping
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.metric import StedPairing
from ggvs_eval.metrics.time import strred
from ggvs_eval.pipelines.inspection.renders.frame_conventions import BT709
from ggvs_eval.pipelines.inspection.renders.recompute import MaskReader, Recomputed, mean_over_views, view_pairs
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames

LUMAS = {"luma BT.601": np.array(strred.LUMA_WEIGHTS), "luma BT.709": BT709}
SCALES = {"0..255": 1.0, "0..1": 1.0 / 255}
OURS = ("disjoint pairs", "mean x mean", "luma BT.601", "0..255")
PAIRINGS = {"disjoint": "disjoint pairs", "consecutive": "consecutive pairs"}
Outputs = dict[tuple[str, str, str], dict[str, float]]


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
    found: dict[str, float] = {}
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
                    found[f"{PAIRINGS[pairing]}, {pooling}, {luma}, {scale}"] = value
    return found


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
