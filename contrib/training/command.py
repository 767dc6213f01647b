"""The verb of the command line that trains the networks of this package: a subcommand per network, and one for all."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import tyro

from ggvs_eval.contrib.training.recipes.recipe import TRAINED_BASELINES
from ggvs_eval.contrib.training.request import Configuration, DataOptions, Guidance, LoopOptions, Size, TrainingRequest
from ggvs_eval.errors import AbsentPartError
from ggvs_eval.pipelines.commands.flags import Output
from ggvs_eval.plugins import missing_part

Training = tyro.conf.OmitArgPrefixes[LoopOptions]
Data = tyro.conf.OmitArgPrefixes[DataOptions]
USUAL_LOOP, USUAL_DATA = LoopOptions(), DataOptions()


def train_stereo(out: Output, training: Training = USUAL_LOOP, start_from: Path | None = None) -> None:
    """Train the compact RAFT-Stereo on pairs of procedural rooms, taken on the fly.

    Args:
        out: folder for the state to go on from, the weights, the logs and the model card.
        training: how the network is trained.
        start_from: weights to begin with where the folder holds no state, such as those that ship; a lower rate moves them.
    """
    _train("stereo", out, _request(training, start_from=start_from))


def train_blend(
    out: Output,
    training: Training = USUAL_LOOP,
    data: Data = USUAL_DATA,
    size: Size = TrainingRequest.size,
    guidance: Guidance = TrainingRequest.guidance,
    start_from: Path | None = None,
) -> None:
    """Train the blending network on procedural rooms and on captures; rooms and their depth are made before the first step.

    It takes no more views than it is trained for, and learns from two views on. The samples are kept in blend-samples beside
    the folder.

    Args:
        out: folder for the state to go on from, the weights, the logs and the model card.
        training: how the network is trained.
        data: the views that the network learns from.
        size: of the U-Net; its first level has 8, 16 or 32 channels.
        guidance: of the fused depth: views registered by it, its channels as the paper prints them, none of it (ablation), or no
            depth at all (naive).
        start_from: weights to begin with where the folder holds no state, such as those that ship.
    """
    _train("blend", out, _request(training, data, size=size, guidance=guidance, start_from=start_from))


def _baseline(name: str) -> Callable[..., None]:
    def train_baseline(
        out: Output,
        training: Training = USUAL_LOOP,
        data: Data = USUAL_DATA,
        configuration: Configuration = TrainingRequest.configuration,
        crop: tuple[int, int] | None = None,
        start_from: Path | None = None,
    ) -> None:
        _train(name, out, _request(training, data, configuration=configuration, crop=crop or (), start_from=start_from))

    train_baseline.__doc__ = f"""Train the baseline {name} on the rooms, captures, targets and sources of the blending network.

    Args:
        out: folder for the state to go on from, the weights, the logs and the model card.
        training: how the network is trained.
        data: the views that the network learns from.
        configuration: compact (about one CPU-hour) or full (the published architecture).
        crop: width and height of the crops that it learns from, multiples of 8 pixels; a GPU can afford larger ones than the
            recipe's.
        start_from: weights to begin with where the folder holds no state, such as those that ship.
    """
    return train_baseline


def train_all(
    out: Output,
    training: Training = USUAL_LOOP,
    data: Data = USUAL_DATA,
    size: Size = TrainingRequest.size,
    configuration: Configuration = TrainingRequest.configuration,
    jobs: int | None = None,
) -> None:
    """Train the blending network with all, no and naive guidance and the baselines, side by side on the same views.

    Args:
        out: gets a folder per network, and the samples.
        training: how each network is trained.
        data: the views that all networks learn from.
        size: of the blending networks; the first level of each has 8, 16 or 32 channels.
        configuration: of the baselines: compact (about one CPU-hour) or full (the published architecture).
        jobs: trainings at a time; by default all of them on a GPU, and one per two cores without.
    """
    _require_rooms()
    from ggvs_eval.contrib.training.train_all import train_all as train_side_by_side

    print(*train_side_by_side(out, _request(training, data, size=size, configuration=configuration), jobs), sep="\n")


TRAININGS: dict[str, Callable[..., None]] = {
    "blend": train_blend,
    "stereo": train_stereo,
    **{name: _baseline(name) for name in TRAINED_BASELINES},
    "all": train_all,
}


def _request(training: LoopOptions, data: DataOptions = USUAL_DATA, **options: Any) -> TrainingRequest:
    return TrainingRequest(**vars(training), **vars(data), **options)


def _require_rooms() -> None:
    if part := missing_part("ggvs_eval.contrib.worlds"):
        raise AbsentPartError(f"train wants rooms of {part}, which is not installed; reinstall ggvs-eval or leave it out")


def _train(network: str, out: Path, request: TrainingRequest) -> None:
    _require_rooms()
    from ggvs_eval.contrib.training.train_one import train_one

    print(*train_one(network, out, request), sep="\n")
