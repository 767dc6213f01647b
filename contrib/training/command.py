"""The verb of the command line that trains the networks of this package: a subcommand per network, and one for all."""

from collections.abc import Callable
from typing import Annotated, Any

import tyro

from ggvs_eval.contrib.training.recipes.recipe import TRAINED_BASELINES
from ggvs_eval.contrib.training.request import ALL, BLEND, STEREO, TrainingOptions, options_class
from ggvs_eval.errors import AbsentPartError
from ggvs_eval.pipelines.commands.flags import Output
from ggvs_eval.plugins import missing_part

ABOUT = {
    BLEND: """Train the blending network on procedural rooms and on captures; rooms and depth are made before the first step.

    It takes no more views than it is trained for, and learns from two views on. The samples are kept in blend-samples next to
    the folder.""",
    STEREO: "Train the compact RAFT-Stereo on pairs of procedural rooms, taken on the fly.",
    **{
        name: f"Train the baseline {name} on the rooms, captures, targets and sources of the blending network."
        for name in TRAINED_BASELINES
    },
    ALL: "Train the blending network with all, no and naive guidance and the baselines, side by side on the same views.",
}
ARGUMENTS = """

    Args:
        out: folder for state, weights, logs and model card; of `all` it gets a folder per network, and the samples.
        training: how the network is trained.
        jobs: trainings at a time; by default all of them on a GPU, and one per two cores without.
    """


def _training(what: str) -> Callable[..., None]:
    """The subcommand of a network, with the options that its training uses."""
    used = options_class(what)

    def train(out: Output, training: Any) -> None:
        _require_rooms()
        from ggvs_eval.contrib.training.train_one import train_one

        print(*train_one(what, out, TrainingOptions(**vars(training))), sep="\n")

    def train_side_by_side(out: Output, training: Any, jobs: int | None = None) -> None:
        _require_rooms()
        from ggvs_eval.contrib.training.train_all import train_all

        print(*train_all(out, TrainingOptions(**vars(training)), jobs), sep="\n")

    command: Callable[..., None] = train_side_by_side if what == ALL else train
    command.__doc__ = ABOUT[what] + ARGUMENTS
    command.__annotations__["training"] = Annotated[used, tyro.conf.OmitArgPrefixes]
    command.__defaults__ = (used(), *(command.__defaults__ or ()))
    return command


TRAININGS: dict[str, Callable[..., None]] = {what: _training(what) for what in ABOUT}


def _require_rooms() -> None:
    if part := missing_part("ggvs_eval.contrib.worlds"):
        raise AbsentPartError(f"train wants rooms of {part}, which is not installed; reinstall ggvs-eval or leave it out")
