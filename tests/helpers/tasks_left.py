"""What a plan has left to make."""

from ggvs_eval.pipelines.run.outlook import count_work
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.tasks.task import Result


def tasks_left(plan: RunPlan) -> list[Result]:
    """Return what is left of a run, its scores included."""
    return [*count_work([plan], plan.run.root).left]
