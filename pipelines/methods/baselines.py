"""The methods that the paper compares itself with."""

from ggvs_eval.baselines.learned import LearnedBaseline
from ggvs_eval.pipelines.methods.spec import OnlineMethod, shipped
from ggvs_eval.results import RETRAINED

NO_BLENDING = OnlineMethod(
    "No Blending",
    "all Gaussians of the K views in one pass, the nearest wins",
    "ggvs_eval.baselines.fixed_blending:NoBlending",
)
DISTANCE_BASED = OnlineMethod(
    "Distance-based Blending",
    "splatted views weighted by camera distance (LLFF)",
    "ggvs_eval.baselines.fixed_blending:DistanceBased",
)
INTERPOLATION = OnlineMethod(
    "View Interpolation",
    "two views warped towards each other by optical flow, where the target is between them",
    "ggvs_eval.baselines.view_interpolation:ViewInterpolation",
    uses_depth=False,
)


def learned_method(baseline: LearnedBaseline) -> OnlineMethod:
    """Return a network that renders with the weights that ship, if any do, or with a checkpoint of
    its authors.
    """
    retrained = baseline.retrained
    return OnlineMethod(
        f"{baseline.title}{RETRAINED.format(retrained)}" if retrained else baseline.title,
        baseline.describe,
        baseline.method,
        given=baseline.options,
        takes=("weights", "device"),
        weights=(shipped(baseline.weights),) if retrained else (),
        checkpoint=f"{baseline.checkpoint}, not included; pass them by --weights "
        f"{baseline.name}=FILE",
        title_from=baseline.title,
        uses_depth=baseline.uses_depth,
        departs=f"{retrained} network, trained here" if retrained else "",
    )
