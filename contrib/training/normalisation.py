"""Batch normalisation when batches are small: running statistics of whole views in place of those of crops."""

from collections.abc import Callable, Iterable

import torch
from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm


def recompute_statistics(network: nn.Module, views: Iterable[Callable[[nn.Module], object]]) -> None:
    """Replace the running statistics of a network by their means over whole views.

    The running mean of a training remembers its last ten crops or so, and a crop's statistics are not those of a view.

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
    """Have a network in training mode normalise by its running statistics, so that it learns as it is used."""
    for layer in _layers(network):
        layer.eval()


def _layers(network: nn.Module) -> list[_BatchNorm]:
    return [layer for layer in network.modules() if isinstance(layer, _BatchNorm)]
