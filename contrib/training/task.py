"""Interface of the training loop to a network: its batches, its loss, its validation."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm


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
        """Return the learning rate of one step of a training of that many steps."""
        cooling = max(1, int(self.cool_down * steps))
        return self.learning_rate * min(1.0, (step + 1) / self.warm_up, (steps - step) / cooling)


class Task(Protocol):
    """A network that is to learn something.

    Batches depend on the step alone, so that a killed training continues unchanged.
    """

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
        """Return a fresh network with seeded weights."""

    def batch(self, step: int) -> Any:
        """Return the samples of one step: tensors in a tuple, list, dict or dataclass.

        Runs in a worker process.
        """

    def loss(self, network: nn.Module, batch: Any) -> tuple[Tensor, Mapping[str, float]]:
        """Return the loss to be minimised, and figures for the log."""

    def settle(self, network: nn.Module) -> None:
        """Make a trained network ready for use: statistics that small crops estimate badly are
        computed from whole views.
        """

    def validate(self, network: nn.Module) -> Mapping[str, float]:
        """Return the figures on data that is never trained on."""


def recompute_statistics(
    network: nn.Module, views: Iterable[Callable[[nn.Module], object]]
) -> None:
    """Replace the running statistics of a network by their means over whole views.

    The running mean of a training remembers its last ten crops or so, and a crop's statistics are
    not those of a view.

    Args:
        network: left in evaluation mode.
        views: each renders a view by the network; none does nothing.
    """
    layers = _layers(network)
    momenta = [layer.momentum for layer in layers]
    network.eval()
    for number, render in enumerate(views):
        for layer in layers:
            if number == 0:
                layer.reset_running_stats()
                layer.momentum = None  # a plain mean over all views
            layer.train()
        with torch.no_grad():
            render(network)
    for layer, momentum in zip(layers, momenta, strict=True):
        layer.momentum = momentum
        layer.eval()


def freeze_statistics(network: nn.Module) -> None:
    """Have a network in training mode normalise by its running statistics, so that it learns as it
    is used.
    """
    for layer in _layers(network):
        layer.eval()


def _layers(network: nn.Module) -> list[_BatchNorm]:
    return [layer for layer in network.modules() if isinstance(layer, _BatchNorm)]
