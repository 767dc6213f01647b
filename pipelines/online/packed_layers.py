"""Layers as the compiled kernels take them, packed once for as long as a network keeps its weights."""

from collections.abc import Callable, Hashable
from typing import TypeVar
from weakref import WeakKeyDictionary

from torch import nn

from ggvs_eval.arrays import Map

Packed = TypeVar("Packed")

_kept: WeakKeyDictionary[nn.Module, tuple[Hashable, object]] = WeakKeyDictionary()


def packed_once(module: nn.Module, key: Hashable, pack: Callable[[], Packed]) -> Packed:
    """Packed layers of a module, cached; packed again when a parameter or the key changes.

    Args:
        module: whose parameters `pack` reads.
        key: whatever else it depends on.
        pack: makes what is kept.
    """
    state = key, tuple((each.data_ptr(), each.stride(), _version(each)) for each in module.parameters())
    kept = _kept.get(module)
    if kept is None or kept[0] != state:
        kept = _kept[module] = state, pack()
    return kept[1]  # type: ignore[return-value]


def _version(parameter: nn.Parameter) -> int:
    """Number of writes to a tensor; inference tensors, which nothing trains, do not count."""
    return -1 if parameter.is_inference() else parameter._version


def parameter_map(module: nn.Module, name: str) -> Map:
    """A parameter as a float32 array."""
    return module.get_parameter(name).detach().float().cpu().numpy()
