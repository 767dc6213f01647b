"""Reads trained weights: tensors by name and their configuration, from safetensors or a checkpoint.

Nothing in it is run.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor, nn

from ggvs_eval.errors import WeightsError

# in the header of safetensors: which of a network's sizes they belong to
CONFIGURATION_NOTE = "configuration"
PARALLEL_PREFIX = "module."  # torch's DataParallel puts it before every name


def read_tensors(path: Path, *keys: str, model: str = "a network") -> dict[str, Tensor]:
    """Return the tensors of a weights file by name.

    Args:
        keys: path of the state dict in a checkpoint: ``("net",)`` for ``checkpoint["net"]``.
            Safetensors of this package hold them under names that begin with the keys, ``net.``.

    Returns:
        Name -> tensor, names without ``module.``.

    Raises:
        WeightsError: absent, damaged, more than tensors and plain values inside, or no state dict
            under those keys.
    """
    if path.suffix == ".safetensors":
        prefix = "".join(f"{key}." for key in keys)
        stored = _safetensors(path, model)
        tensors = {
            name.removeprefix(prefix): tensor
            for name, tensor in stored.items()
            if name.startswith(prefix)
        }
    else:
        tensors = _state_dict(_checkpoint(path, model), keys, path)
    if not tensors:
        raise WeightsError(
            f"{path}: wanted tensors{_under(keys)}, got none; give weights of {model}"
        )
    return {name.removeprefix(PARALLEL_PREFIX): tensor for name, tensor in tensors.items()}


def configuration_of(path: Path, names: Collection[str], model: str) -> str | None:
    """Return the configuration recorded in a weights file.

    Returns:
        The name, None if the file says nothing: a checkpoint of the authors, or a copy of it, which
        is the full one.
    """
    name = read_notes(path).get(CONFIGURATION_NOTE)
    if name is not None and name not in names:
        raise WeightsError(
            f"{path}: wanted a configuration of {model} ({', '.join(names)}), got {name}; train it "
            f"again"
        )
    return name


def read_notes(path: Path) -> dict[str, str]:
    """Return the texts in the header of safetensors.

    None of a checkpoint, or if there is no file.
    """
    if path.suffix != ".safetensors" or not path.is_file():
        return {}
    try:
        with safe_open(path, "pt") as file:
            return dict(file.metadata() or {})
    except (SafetensorError, OSError) as error:
        raise WeightsError(
            f"{path}: damaged, or not safetensors ({error}); fetch it again"
        ) from error


def load_strict(tensors: Mapping[str, Tensor], network: nn.Module, path: Path, model: str) -> None:
    """Give a network tensors that are its own by name and shape, every one of them.

    Args:
        tensors: what `read_tensors` found; half precision is widened.
    """
    require_shapes(tensors, network, path, model)
    network.load_state_dict(
        {
            name: tensor.float() if tensor.is_floating_point() else tensor
            for name, tensor in tensors.items()
        }
    )


def require_shapes(
    tensors: Mapping[str, Tensor], network: nn.Module, path: Path, model: str
) -> None:
    """Refuse tensors that are not a network's own by name and shape, every one of them.

    Args:
        tensors: what `read_tensors` found.
        network: network that they must fit; may be on the device ``meta``, which costs no memory.
    """
    own_shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    different = sorted(
        name
        for name in own_shapes.keys() | shapes.keys()
        if own_shapes.get(name) != shapes.get(name)
    )
    if different:
        name = different[0]
        raise WeightsError(
            f"{path}: {len(different)} tensors differ from {model}, first {name}: "
            f"wanted {own_shapes.get(name)}, got {shapes.get(name)}; give weights of {model}"
        )


def _safetensors(path: Path, model: str) -> dict[str, Tensor]:
    try:
        return load_file(path)
    except OSError as error:
        raise _unreadable(path, model, error) from error
    except SafetensorError as error:
        raise WeightsError(
            f"{path}: damaged, or not safetensors ({error}); fetch it again"
        ) from error


def _checkpoint(path: Path, model: str) -> Any:
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise _unreadable(path, model, error) from error
    # a damaged pickle makes torch stumble anywhere: IndexError, AssertionError, struct.error, ...
    except Exception as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise WeightsError(
            f"{path}: wanted a file of tensors only, got {reason}; give a checkpoint with a state "
            f"dict"
        ) from error


def _unreadable(path: Path, model: str, error: OSError) -> WeightsError:
    return WeightsError(
        f"{path}: wanted weights of {model}, got no readable file ({error.strerror or error})"
    )


def _state_dict(values: Any, keys: tuple[str, ...], path: Path) -> dict[str, Tensor]:
    for key in keys:
        if not isinstance(values, Mapping) or key not in values:
            content = (
                ", ".join(map(str, values))
                if isinstance(values, Mapping)
                else type(values).__name__
            )
            raise WeightsError(f"{path}: wanted a state dict{_under(keys)}, got {content[:200]}")
        values = values[key]
    if not isinstance(values, Mapping) or not all(
        isinstance(name, str) and isinstance(value, Tensor) for name, value in values.items()
    ):
        raise WeightsError(
            f"{path}: wanted a state dict (name -> tensor){_under(keys)}, got a "
            f"{type(values).__name__} with non-tensor values"
        )
    return dict(values)


def _under(keys: tuple[str, ...]) -> str:
    return f" under {'/'.join(keys)}" if keys else ""
