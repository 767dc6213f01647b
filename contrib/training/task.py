"""Interface of the training loop to a network: its batches, its loss, its validation."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from torch import Tensor, nn


@dataclass(frozen=True)
class Schedule:
    """Optimiser settings: learning rate, weight decay, gradient clipping, averaged weights.

    Attributes:
        learning_rate: of AdamW after the warm-up.
        warm_up: steps over which the learning rate rises from zero.
        cool_down: share of all steps, at their end, over which it falls to zero again.
        clip: largest norm of the gradient.
        average: largest decay per step of the averaged weights, which are validated and shipped.
    """

    learning_rate: float = 4e-4
    weight_decay: float = 1e-5
    warm_up: int = 200
    cool_down: float = 0.25
    clip: float = 1.0
    average: float = 0.998

    def rate(self, step: int, steps: int) -> float:
        """Learning rate of one step of a training of that many steps."""
        cooling = max(1, int(self.cool_down * steps))
        return self.learning_rate * min(1.0, (step + 1) / self.warm_up, (steps - step) / cooling)


class Task(Protocol):
    """A network that is to learn something; batches depend on the step alone, so that a killed training goes on unchanged."""

    @property
    def name(self) -> str:
        """Names the weights."""

    @property
    def summary(self) -> str:
        """One sentence for the model card on the network."""

    @property
    def data(self) -> str:
        """One sentence for the model card on the training data."""

    @property
    def evaluated_on(self) -> str:
        """One sentence for the model card on the measures of `validate`."""

    @property
    def schedule(self) -> Schedule:
        """Optimiser settings: learning rate, weight decay, gradient clipping, averaged weights."""

    @property
    def step_pixels(self) -> int:
        """Pixels of target views that a step learns from."""

    def network(self) -> nn.Module:
        """A fresh network with seeded weights."""

    def batch(self, step: int) -> Any:
        """The samples of one step: tensors in a tuple, list, dict or dataclass. Runs in a worker process."""

    def loss(self, network: nn.Module, batch: Any) -> tuple[Tensor, Mapping[str, float]]:
        """Return the loss to be minimised, and figures for the log."""

    def settle(self, network: nn.Module) -> None:
        """Make a trained network ready for use: statistics that small crops estimate badly are computed from whole views."""

    def validate(self, network: nn.Module) -> Mapping[str, float]:
        """Figures on data that is never trained on."""
