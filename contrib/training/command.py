"""The verb of the command line that trains the networks of this package: a subcommand per network,
and one for all.
"""

from collections.abc import Callable
from typing import Annotated, Any

import tyro

from ggvs_eval.contrib.training.recipes.recipe import TRAINED_BASELINES
from ggvs_eval.contrib.training.request import ALL, BLEND, STEREO, TrainingOptions, options_class
from ggvs_eval.errors import AbsentPartError
from ggvs_eval.pipelines.commands.flags import Output
from ggvs_eval.plugins import missing_part

ABOUT = {
    BLEND: """Train the blending network on procedural rooms and captures.

    Rooms and depth are made before the first step. It learns from two views on. The samples are
    stored in blend-samples next to the folder.""",
    STEREO: "Train the compact RAFT-Stereo on pairs of procedural rooms.",
    **{
        name: f"Train the baseline {name} on the views of the blending network."
        for name in TRAINED_BASELINES
    },
    ALL: "Train the blending network (all, no, naive guidance) and all baselines in parallel.",
}
ARGUMENTS = """

    Args:
        out: folder for state, weights, logs and model card; for `all` one per network, and the
            samples.
        training: training options.
        jobs: parallel trainings; by default all on a GPU, one per two cores without.
    """


def _training(name: str) -> Callable[..., None]:
    """Return the subcommand of a network, with the options that its training uses."""
    options = options_class(name)

    def train(out: Output, training: Any) -> None:
        _require_rooms()
        from ggvs_eval.contrib.training.train_one import train_one

        print(*train_one(name, out, TrainingOptions(**vars(training))), sep="\n")

    def train_side_by_side(out: Output, training: Any, jobs: int | None = None) -> None:
        _require_rooms()
        from ggvs_eval.contrib.training.train_all import train_all

        print(*train_all(out, TrainingOptions(**vars(training)), jobs), sep="\n")

    command: Callable[..., None] = train_side_by_side if name == ALL else train
    command.__doc__ = ABOUT[name] + ARGUMENTS
    command.__annotations__["training"] = Annotated[options, tyro.conf.OmitArgPrefixes]
    command.__defaults__ = (options(), *(command.__defaults__ or ()))
    return command


TRAININGS: dict[str, Callable[..., None]] = {name: _training(name) for name in ABOUT}


def _require_rooms() -> None:
    if part := missing_part("ggvs_eval.contrib.worlds"):
        raise AbsentPartError(
            f"train: wanted {part} for its rooms, got no such part; reinstall ggvs-eval"
        )
