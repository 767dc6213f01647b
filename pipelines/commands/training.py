"""The verb of the command line that trains the networks of this package."""

from typing import Annotated, Literal

import tyro

from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.commands.captures import Folder
from ggvs_eval.pipelines.training.request import TrainingRequest

What = Literal["stereo", "blend", "fwd", "gps-gaussian", "ibrnet", "enerf", "all"]


def train(
    what: Annotated[What, tyro.conf.Positional],
    out: Folder,
    request: tyro.conf.OmitArgPrefixes[TrainingRequest] = TrainingRequest(),  # noqa: B008 - frozen
    jobs: int | None = None,
) -> None:
    """Train a network of this package; a second call goes on where the first one stopped.

    Args:
        what: stereo: the compact RAFT-Stereo, on scenes made on the fly. blend: the blending network, on rooms that are rendered,
            and whose depth is estimated, before the first step (blend-samples beside the folder). fwd, gps-gaussian, ibrnet,
            enerf: a baseline, on the same rooms, captures, targets and sources. all: blend with all, no and naive guidance and
            the baselines, side by side, each into a folder of its own in the folder.
        out: folder for the state to go on from, the weights, the logs and the model card.
        request: what is asked for.
        jobs: all: trainings at a time; by default all of them on a GPU, and one per two cores without.
    """
    if what == "all":
        from ggvs_eval.pipelines.training.train_all import train_all

        print(*train_all(out, request, jobs), sep="\n")
        return
    if jobs is not None:
        raise TrainingError(f"train {what}: wanted one training, got --jobs {jobs}; leave it out, or train all")
    from ggvs_eval.pipelines.training.train_one import train_one

    print(*train_one(what, out, request), sep="\n")
