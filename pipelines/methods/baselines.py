"""The methods that the paper compares itself with."""

from collections.abc import Callable
from functools import partial

from ggvs_eval.baselines.learned import LearnedBaseline, Rendition
from ggvs_eval.errors import WeightsError
from ggvs_eval.method import Method
from ggvs_eval.pipelines.methods.spec import OnlineMethod, shipped

FIXED = ("ggvs_eval.baselines.fixed_blending",)


def _no_blending() -> Method:
    from ggvs_eval.baselines.fixed_blending import NoBlending

    return NoBlending()


def _distance_based() -> Method:
    from ggvs_eval.baselines.fixed_blending import DistanceBased

    return DistanceBased()


def _interpolation() -> Method:
    from ggvs_eval.baselines.view_interpolation import ViewInterpolation

    return ViewInterpolation()


FIXED_BASELINES: dict[str, OnlineMethod] = {
    "no-blending": OnlineMethod("No Blending", "all Gaussians of the K views in one pass, the nearest wins", FIXED, _no_blending),
    "distance-based": OnlineMethod(
        "Distance-based Blending", "splatted views weighted by camera distance (LLFF)", FIXED, _distance_based
    ),
    "interpolation": OnlineMethod(
        "View Interpolation",
        "two views warped towards each other by optical flow, where the target lies between them",
        ("ggvs_eval.baselines.view_interpolation",),
        _interpolation,
        usual=False,
        uses_depth=False,
    ),
}


def method_of_label(baseline: LearnedBaseline, label: str) -> OnlineMethod:
    """The rendition of a learned baseline that a label names."""
    return next(learned_method(baseline, each) for each in baseline.renditions if baseline.label(each) == label)


def learned_method(baseline: LearnedBaseline, rendition: Rendition) -> OnlineMethod:
    """A network that renders with the weights that ship, if any do, or with a checkpoint of its authors."""
    retrained = rendition.retrained
    make_from = partial(baseline.make_method, **rendition.options)
    return OnlineMethod(
        f"{rendition.title} (retrained, {retrained})" if retrained else rendition.title,
        rendition.describe,
        (baseline.method.partition(":")[0],),
        partial(_with_shipped_weights, baseline, rendition, make_from),
        usual=False,
        weights=(shipped(baseline.weights),) if retrained else (),
        checkpoint=baseline.checkpoint,
        make_from=make_from,
        title_from=rendition.title,
        uses_depth=rendition.uses_depth,
        departs=f"{retrained} network, trained here" if retrained else "",
    )


def _with_shipped_weights(
    baseline: LearnedBaseline, rendition: Rendition, make_from: Callable[..., Method], device: str = "cpu"
) -> Method:
    weights = shipped(baseline.weights)
    if not rendition.retrained or not weights.is_file():
        raise WeightsError(
            f"{rendition.title}: its weights do not ship; wanted {baseline.checkpoint}, give it by --weights {baseline.name}=FILE"
        )
    return make_from(weights, device=device)
