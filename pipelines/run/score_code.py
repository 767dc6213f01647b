"""The code behind each score: a value is stale when the code that measures it has changed, and only then."""

from collections.abc import Collection, Sequence

from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.metrics.metric import Metric
from ggvs_eval.metrics.path_scores import measured_on_path
from ggvs_eval.metrics.registry import METRICS

# They read the frames and hand them to every metric: their own text counts for all, what they import for one does not.
SHARED = ("ggvs_eval.pipelines.run.score_view", "ggvs_eval.metrics.stream", "ggvs_eval.metrics.metric")
READING = "ggvs_eval.files.images"
CHECKS = "ggvs_eval.pipelines.inspection.renders.quick_checks"
PATH_SCORES = "ggvs_eval.metrics.path_scores"


def metric_code(metric: Metric) -> str:
    """Return the hash of the code that measures a metric of a view."""
    return code_identity(*metric.modules, READING, *SHARED, unfollowed=SHARED)


def checks_code() -> str:
    """Return the hash of the code of the checks that a view's frames go through."""
    return code_identity(CHECKS)


def ceilings_code(names: Sequence[str]) -> str:
    """Return the hash of the code that estimates the ceilings of some metrics."""
    modules = [module for name in names for module in METRICS[name].modules]
    return code_identity("ggvs_eval.metrics.ceilings", *modules, READING, *SHARED, unfollowed=SHARED)


def path_code(names: Collection[str]) -> str:
    """Hash of the code that measures a camera path: one pass over it measures all that it has, and what is named of the rest."""
    modules = [module for metric in measured_on_path(names) for module in metric.modules]
    return code_identity(PATH_SCORES, "ggvs_eval.metrics.path.rendered_path", *modules, READING, unfollowed=(PATH_SCORES,))
