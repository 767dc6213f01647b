"""Trained weights as they ship: half precision, safetensors."""

from collections.abc import Mapping
from pathlib import Path

from safetensors.torch import save_file
from torch import nn

from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.files.weights_file import load_strict, read_tensors

NETWORK = "the network to be trained"  # in messages


def write_weights(path: Path, network: nn.Module, notes: Mapping[str, str]) -> None:
    """Write a network's weights in half precision, under a temporary name first.

    Args:
        path: the .safetensors file.
        network: whose weights.
        notes: texts for the file's header.
    """
    tensors = {
        name: (tensor.half() if tensor.is_floating_point() else tensor).contiguous().cpu()
        for name, tensor in network.state_dict().items()
    }
    with atomic_file(path) as temporary:
        save_file(tensors, temporary, dict(notes))


def pour_weights(path: Path, network: nn.Module) -> None:
    """Give a network the weights of such a file.

    Raises:
        WeightsError: absent, damaged, or of another network.
    """
    load_strict(read_tensors(path, of=NETWORK), network, path, NETWORK)
