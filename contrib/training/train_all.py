"""All networks from one command: samples first, then trainings side by side, each as the single command would run it."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ggvs_eval.compute_device import compute_device
from ggvs_eval.contrib.training.recipes.recipe import TRAINED_BASELINES
from ggvs_eval.contrib.training.request import Guidance, TrainingRequest
from ggvs_eval.contrib.training.samples.sample_kinds import BlendKind, InstantKind
from ggvs_eval.contrib.training.samples.training_data import prepare_samples, sample_pools
from ggvs_eval.contrib.training.side_by_side import Training, default_jobs, run_trainings
from ggvs_eval.contrib.training.train_one import CACHE, sample_device, sample_workers
from ggvs_eval.errors import TrainingError
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.pipelines.online.blend_weights import weights_name

Network = tuple[str, Guidance]  # what `train` calls it, and what blend sees of the fused depth
NETWORKS: tuple[Network, ...] = (
    ("blend", "registered"),
    ("blend", "none"),
    ("blend", "naive"),
    *((what, "registered") for what in TRAINED_BASELINES),
)


def train_all(
    folder: Path, request: TrainingRequest, jobs: int | None = None, networks: Sequence[Network] = NETWORKS
) -> list[Path]:
    """Train all networks of a comparison on the same views; finished ones are not trained again.

    Args:
        folder: gets a folder per network, with state, logs, curve, weights and card, and the samples.
        jobs: trainings at a time; by default all on a GPU, one per two cores on a CPU.

    Raises:
        DeviceError: there is no such device here.
        TrainingError: nothing to learn from, an option that is for one network alone, or trainings that failed; all others are
            finished then.
    """
    device = compute_device(request.device)
    if request.start_from is not None or request.guidance != "registered":
        raise TrainingError(
            "train all: wanted options that all networks share, got --start-from or --guidance; train that network alone, as "
            "`ggvs-eval train blend` does, and call again"
        )
    trainings = planned_trainings(folder, request, networks)
    prepare_all(folder / CACHE, request, networks)
    failures = run_trainings(trainings, default_jobs(device.type, len(trainings)) if jobs is None else jobs)
    if failures:
        print(*failures.values(), sep="\n", file=sys.stderr)
        raise TrainingError(
            f"train all: wanted {len(trainings)} trained networks, {', '.join(failures)} failed, the others are trained; mend "
            "what their logs say and call again to go on"
        )
    return [training.folder / f"{training.name}{end}" for training in trainings for end in (".safetensors", ".md")]


def planned_trainings(folder: Path, request: TrainingRequest, networks: Sequence[Network] = NETWORKS) -> list[Training]:
    """The command of each network's training."""
    trainings = []
    for what, guidance in networks:
        name = weights_name(guidance) if what == "blend" else what
        words = replace(request, guidance=guidance).words(what)
        trainings.append(Training(name, folder / name, ("train", what, str(folder / name), *words), request.steps))
    return trainings


def prepare_all(cache: Path, request: TrainingRequest, networks: Sequence[Network] = NETWORKS) -> None:
    """Make the samples that any of the networks lacks, with all cores; rooms are rendered once for all."""
    if any(what == "blend" for what, _ in networks):
        device = sample_device(request)
        prepare_samples(*sample_pools(cache, request, BlendKind(device)), sample_workers(device))
    for depth in sorted({TRAINED_BASELINES[what].takes_depth for what, _ in networks if what in TRAINED_BASELINES}):
        prepare_samples(*sample_pools(cache, request, InstantKind(depth)), default_workers())
