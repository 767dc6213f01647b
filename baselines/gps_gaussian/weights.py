"""Trained weights of GPS-Gaussian: the authors' checkpoint of their second stage, or safetensors of ours."""

from functools import lru_cache
from pathlib import Path

import torch
from torch.serialization import safe_globals

from ggvs_eval.baselines.configuration import FULL, configuration_of
from ggvs_eval.baselines.gps_gaussian.network import CONFIGURATIONS, GpsGaussianNetwork
from ggvs_eval.files.weights_file import load_strict, read_tensors

OF = "GPS-Gaussian (GPS-GS_stage2_final.pth)"

# Until version 2.0 torch kept one of its own functions in the state of a OneCycleLR scheduler, as `getattr` of the class by name,
# and the authors' checkpoint holds such a state. What is read in place of both calls is nothing at all.
FORGOTTEN = ("builtins.getattr", "torch.optim.lr_scheduler.OneCycleLR")


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> GpsGaussianNetwork:
    """The network of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint (a dict with ``network`` beside ``total_steps``, ``optimizer`` and ``scheduler``), or
            safetensors whose names begin with ``network.``, or what our training wrote.
        device: where the network shall lie.

    Raises:
        WeightsError: absent, damaged, more than tensors and plain values inside, or tensors of another network.
    """
    configuration = configuration_of(path, CONFIGURATIONS, OF)
    with safe_globals([(_nothing, name) for name in FORGOTTEN]):
        tensors = read_tensors(path, *(() if configuration else ("network",)), of=OF)
    network = GpsGaussianNetwork(configuration or FULL)
    load_strict(tensors, network, path, OF)
    return network.eval().to(device)


def _nothing(*_: object) -> None:
    """Stands in for what a checkpoint need not bring back."""
