"""The code behind each score: a value is stale when the code that measures it has changed, and only then."""

from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.metrics.metric import Metric
from ggvs_eval.scoring import QUESTIONS

# They read the frames and hand them to every metric: their own text counts for all, what they import for one does not.
SHARED = ("ggvs_eval.pipelines.run.score_view", "ggvs_eval.metrics.stream", "ggvs_eval.metrics.metric")
READING = "ggvs_eval.files.images"


def metric_code(metric: Metric) -> str:
    """Return the hash of the code that measures a metric of a view."""
    return code_identity(*metric.modules, READING, *SHARED, unfollowed=SHARED)


def checks_code() -> str:
    """Return the hash of the code of the questions that are asked of a view's frames."""
    return code_identity(*(str(QUESTIONS.root(name)) for name in QUESTIONS.present()))
