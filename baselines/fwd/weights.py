"""Trained weights of FWD: safetensors of ours, or a torch file that holds the same state dict."""

from functools import lru_cache
from pathlib import Path

import torch

from ggvs_eval.baselines.configuration import FULL, configuration_of
from ggvs_eval.baselines.fwd.network import CONFIGURATIONS, FwdNetwork
from ggvs_eval.files.weights_file import load_strict, read_tensors

OF = "FWD (this project's names)"


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> FwdNetwork:
    """The network of a weights file, in evaluation mode, on a device.

    Whether it completes depth is known from its tensors, which configuration it is from its header.

    Raises:
        WeightsError: absent, damaged, more than tensors inside, or tensors of another network.
    """
    tensors = read_tensors(path, of=OF)
    configuration = configuration_of(path, CONFIGURATIONS, OF) or FULL
    network = FwdNetwork(any(name.startswith("completion.") for name in tensors), configuration)
    load_strict(tensors, network, path, OF)
    return network.eval().to(device)
