"""The trainings of the baselines by the names that the command line has for them."""

from pathlib import Path

from ggvs_eval.pipelines.training.baselines.baseline_task import BaselineTask
from ggvs_eval.pipelines.training.baselines.enerf_task import EnerfTask
from ggvs_eval.pipelines.training.baselines.fwd_task import FwdTask
from ggvs_eval.pipelines.training.baselines.gps_gaussian_task import GpsGaussianTask
from ggvs_eval.pipelines.training.baselines.ibrnet_task import IbrnetTask
from ggvs_eval.pipelines.training.samples.training_data import TrainingData, baseline_samples

BASELINE_TASKS: dict[str, type[BaselineTask]] = {
    "fwd": FwdTask,
    "gps-gaussian": GpsGaussianTask,
    "ibrnet": IbrnetTask,
    "enerf": EnerfTask,
}
TAKING_DEPTH = ("fwd", "gps-gaussian")


def baseline_task(what: str, cache: Path, data: TrainingData, configuration: str = "compact", seed: int = 0) -> BaselineTask:
    """The training of a baseline on the views that the blending network learns from.

    Args:
        what: one of `BASELINE_TASKS`.
        cache: where rooms and samples are kept.
        data: what is learned from.
        configuration: of the network.
        seed: of the weights and the crops.
    """
    training, validation = baseline_samples(cache, data, what in TAKING_DEPTH)
    return BASELINE_TASKS[what](training, validation, configuration, seed)
