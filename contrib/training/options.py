"""Options of a training, whatever is trained."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Precision = Literal["auto", "float32", "bfloat16"]


@dataclass(frozen=True)
class LoopOptions:
    """Options of the training loop; none changes the result but `steps`, `seed`, `precision` and the device.

    Attributes:
        steps: of the whole training, those of earlier calls included.
        seed: of the weights and the scenes.
        device: cpu, cuda, or the better one by default.
        precision: of convolutions; auto takes bfloat16 where the hardware multiplies it faster.
        workers: processes that make batches.
        compile_network: let torch compile it first: some minutes once, a fifth less per step.
    """

    steps: int = 20000
    seed: int = 0
    device: str = "auto"
    precision: Precision = "auto"
    workers: int = 1
    compile_network: bool = False


@dataclass(frozen=True)
class TrainingOptions(LoopOptions):
    """Options of a training, those that the command line does not show included.

    Attributes:
        start_from: weights that a training without a state begins with, such as those that ship.
        save_every: steps between checkpoints.
        validate_every: steps between validations.
    """

    start_from: Path | None = None
    save_every: int = 100
    validate_every: int = 500
