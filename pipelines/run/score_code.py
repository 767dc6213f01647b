"""The code behind each score: a value is stale when the code that measures it has changed, and only
then.
"""

from ggvs_eval.metrics.metric import Metric
from ggvs_eval.scoring import QUESTIONS
from ggvs_eval.tasks.identity import code_of

# Rooms that every metric may build on.
MEASURING = ("ggvs_eval.metrics.image", "ggvs_eval.metrics.noise", "ggvs_eval.statistics")


def metric_code(metric: Metric) -> str:
    """Return the hash of the code that measures a metric of a view."""
    return code_of(*metric.modules, *MEASURING)


def checks_code() -> str:
    """Return the hash of the code of the questions that are asked of a view's frames."""
    return code_of(*(str(QUESTIONS.root(name)) for name in QUESTIONS.present()))
