"""The trainings of the baselines by the names that the command line has for them."""

from pathlib import Path

from ggvs_eval.pipelines.training.baseline_task import BaselineTask
from ggvs_eval.pipelines.training.enerf_task import EnerfTask
from ggvs_eval.pipelines.training.fwd_task import FwdTask
from ggvs_eval.pipelines.training.gps_gaussian_task import GpsGaussianTask
from ggvs_eval.pipelines.training.ibrnet_task import IbrnetTask
from ggvs_eval.pipelines.training.room_instants import RoomInstants
from ggvs_eval.pipelines.training.room_plan import RoomPlan, validation_plan

BASELINE_TASKS: dict[str, type[BaselineTask]] = {
    "fwd": FwdTask,
    "gps-gaussian": GpsGaussianTask,
    "ibrnet": IbrnetTask,
    "enerf": EnerfTask,
}
TAKING_DEPTH = ("fwd", "gps-gaussian")


def baseline_task(what: str, cache: Path, plan: RoomPlan, configuration: str = "compact", seed: int = 0) -> BaselineTask:
    """The training of a baseline on the samples of a plan.

    Args:
        what: one of `BASELINE_TASKS`.
        cache: where rooms and samples are kept.
        plan: of the samples to learn from.
        configuration: of the network.
        seed: of the weights and the crops.
    """
    depth = what in TAKING_DEPTH
    validation = RoomInstants(cache, validation_plan(plan.views, plan.matcher), depth)
    return BASELINE_TASKS[what](RoomInstants(cache, plan, depth), validation, configuration, seed)
