"""The verb of the command line that trains the networks that ship."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from ggvs_eval.pipelines.cli_captures import Folder

Precision = Literal["auto", "float32", "bfloat16"]


def train(
    what: Annotated[Literal["stereo"], tyro.conf.Positional],
    out: Folder,
    steps: int = 20000,
    seed: int = 0,
    device: str = "auto",
    precision: Precision = "auto",
    workers: int = 1,
    compile_network: bool = False,
    start_from: Path | None = None,
) -> None:
    """Train a network that ships with the package; a second call goes on where the first one stopped.

    Args:
        what: stereo: the compact RAFT-Stereo, on scenes that are made on the fly.
        out: folder for the state to go on from, the weights, the logs and the model card.
        steps: of the whole training, those of earlier calls included.
        seed: of the weights and the scenes.
        device: cpu, cuda, or the better one by default.
        precision: of convolutions; auto takes bfloat16 where the hardware multiplies it faster.
        workers: processes that make scenes.
        start_from: weights to begin with where the folder holds no state, such as those that ship.
        compile_network: let torch compile it first: some minutes once, a fifth less per step.
    """
    from ggvs_eval.pipelines.training.card import write_card
    from ggvs_eval.pipelines.training.loop import TrainingOptions
    from ggvs_eval.pipelines.training.loop import train as go_on
    from ggvs_eval.pipelines.training.stereo_task import StereoTask

    task = StereoTask(seed=seed)
    options = TrainingOptions(
        steps=steps, device=device, precision=precision, workers=workers, compile=compile_network, start_from=start_from
    )
    command = f"ggvs-eval train {what} {out.name} --steps {steps} --seed {seed}"
    print(go_on(task, out, options), write_card(task, out, command), sep="\n")
