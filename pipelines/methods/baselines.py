"""The methods that the paper compares itself with."""

from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.baselines.learned import LearnedBaseline, Rendition
from ggvs_eval.errors import WeightsError
from ggvs_eval.method import Method
from ggvs_eval.pipelines.methods.spec import OnlineMethod, make, shipped
from ggvs_eval.results import RETRAINED

FIXED = ("ggvs_eval.baselines.fixed_blending",)

FIXED_BASELINES: dict[str, OnlineMethod] = {
    "no-blending": OnlineMethod(
        "No Blending",
        "all Gaussians of the K views in one pass, the nearest wins",
        FIXED,
        partial(make, "ggvs_eval.baselines.fixed_blending:NoBlending"),
    ),
    "distance-based": OnlineMethod(
        "Distance-based Blending",
        "splatted views weighted by camera distance (LLFF)",
        FIXED,
        partial(make, "ggvs_eval.baselines.fixed_blending:DistanceBased"),
    ),
    "interpolation": OnlineMethod(
        "View Interpolation",
        "two views warped towards each other by optical flow, where the target is between them",
        ("ggvs_eval.baselines.view_interpolation",),
        partial(make, "ggvs_eval.baselines.view_interpolation:ViewInterpolation"),
        usual=False,
        uses_depth=False,
    ),
}


def method_of_label(baseline: LearnedBaseline, label: str) -> OnlineMethod:
    """Return the rendition of a learned baseline that a label names."""
    return next(learned_method(baseline, each) for each in baseline.renditions if baseline.label(each) == label)


def learned_method(baseline: LearnedBaseline, rendition: Rendition) -> OnlineMethod:
    """Return a network that renders with the weights that ship, if any do, or with a checkpoint of its authors."""
    retrained = rendition.retrained
    return OnlineMethod(
        f"{rendition.title}{RETRAINED.format(retrained)}" if retrained else rendition.title,
        rendition.describe,
        (baseline.method.partition(":")[0],),
        partial(_with_weights, baseline, rendition),
        given=rendition.options,
        takes=("weights", "device"),
        usual=False,
        weights=(shipped(baseline.weights),) if retrained else (),
        checkpoint=baseline.checkpoint,
        title_from=rendition.title,
        uses_depth=rendition.uses_depth,
        departs=f"{retrained} network, trained here" if retrained else "",
    )


def _with_weights(
    baseline: LearnedBaseline, rendition: Rendition, weights: Path | None = None, device: str = "cpu", **options: Any
) -> Method:
    """With a checkpoint, or with the weights that ship."""
    weights = weights or shipped(baseline.weights)
    if weights == shipped(baseline.weights) and not (rendition.retrained and weights.is_file()):
        raise WeightsError(
            f"{rendition.title}: wanted weights {baseline.checkpoint}, not included; pass them by --weights {baseline.name}=FILE"
        )
    return baseline.make_method(weights, device=device, **options)
