"""Checkpoints of a training: its state, to go on exactly where it was, and its weights as they ship."""

import io
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import save
from torch import nn
from torch.optim.swa_utils import AveragedModel

from ggvs_eval.errors import TrainingError
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.files.weights_file import load_strict, read_notes, read_tensors

NETWORK = "the network to be trained"  # in messages
PIXELS_NOTE = "pixels"  # in the header of weights


@dataclass
class TrainingState:
    """Everything that changes while training.

    Attributes:
        pixels: of target views that were learned from, those of the weights that it began with included.
        network: the weights that are moved.
    """

    step: int
    pixels: int
    network: nn.Module
    average: AveragedModel
    optimiser: torch.optim.Optimizer


def state_file(folder: Path) -> Path:
    """Return the path of a training's state."""
    return folder / "state.pt"


def write_state(folder: Path, state: TrainingState) -> None:
    """Write it under a temporary name and rename it, so that a kill leaves the old one or the new one."""
    values = {
        "step": state.step,
        "pixels": state.pixels,
        "network": state.network.state_dict(),
        "average": state.average.state_dict(),
        "optimiser": state.optimiser.state_dict(),
    }
    buffer = io.BytesIO()  # torch says of a full disk that something failed, not what
    torch.save(values, buffer)
    write_bytes(state_file(folder), buffer.getvalue())


def read_state(folder: Path, fresh: TrainingState, device: torch.device) -> TrainingState:
    """The state of a folder poured into a fresh one; the fresh one itself where there is none."""
    path = state_file(folder)
    if not path.is_file():
        return fresh
    try:
        values = torch.load(path, map_location=device, weights_only=True)
        fresh.network.load_state_dict(values["network"])
        fresh.average.load_state_dict(values["average"])
        fresh.optimiser.load_state_dict(values["optimiser"])
        fresh.step, fresh.pixels = int(values["step"]), int(values.get("pixels", 0))
    except (RuntimeError, KeyError, ValueError, TypeError, EOFError, pickle.UnpicklingError) as error:
        reason = str(error).splitlines()[0]
        raise TrainingError(f"{path}: not a state of this training ({reason}); choose another folder or delete it") from error
    return fresh


def write_weights(path: Path, network: nn.Module, notes: Mapping[str, str]) -> None:
    """Write a network's weights in half precision, under a temporary name first."""
    tensors = {
        name: (tensor.half() if tensor.is_floating_point() else tensor).contiguous().cpu()
        for name, tensor in network.state_dict().items()
    }
    write_bytes(path, save(tensors, dict(notes)))


def pour_weights(path: Path, network: nn.Module) -> int:
    """Give a network the weights of such a file; one that says how earlier weights are `completed` takes those, too.

    Returns:
        Pixels that they have learned from, 0 where the file does not say.
    """
    completed = getattr(network, "completed", dict)
    load_strict(completed(read_tensors(path, of=NETWORK)), network, path, NETWORK)
    return int(read_notes(path).get(PIXELS_NOTE, 0))
