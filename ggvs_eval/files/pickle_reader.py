"""Pickles of plain data, read as data; the script of the `SideProcess` for those of strangers.

A pickle is a program. Here it finds no names but stand-ins for those that numpy's arrays are made
by: no code of it runs, and numpy, which trusts what a state says, is given numbers alone. What a
few bytes may claim beside that (a memo of 34 GB, a hash without end) ends with the process that
reads them.
"""

import json
import pickle
import re
import resource
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 4 << 30  # of the process, its libraries among them
# signs; lists may share their items, so that few of them represent very many
LONGEST_ANSWER = 1 << 24


class _Type:
    """Stands in for `numpy.dtype`: a type of numbers, such as ``f8``, and its byte order."""

    def __init__(self, kind: str, *_: Any) -> None:
        if not re.fullmatch("[<>|=]?[fiu][1248]", kind):
            raise ValueError("an array that is not made of numbers")
        self.kind = kind[-2:]

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.kind = state[1] + self.kind


class _Array:
    """Stands in for an array: made empty, then given its content."""

    values: NDArray[np.generic]

    def __init__(self, *_: Any) -> None:
        """Ignore class and shape: both come again with the content."""

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, kind, is_fortran, content = state
        content = content.encode("latin-1") if isinstance(content, str) else content
        self.values = _numbers(content, kind, shape, "F" if is_fortran else "C")


def _from_buffer(
    content: bytes, kind: _Type, shape: tuple[int, ...], order: Literal["C", "F"]
) -> _Array:
    array = _Array()
    array.values = _numbers(content, kind, shape, order)
    return array


def _numbers(
    content: bytes, kind: _Type, shape: tuple[int, ...], order: Literal["C", "F"]
) -> NDArray[np.generic]:
    return np.frombuffer(content, np.dtype(kind.kind)).reshape(shape, order=order)


def _encode(text: str, encoding: str) -> bytes:
    """Return the bytes that were pickled as text, always in this encoding."""
    return text.encode("latin-1")


STAND_INS = {
    "numpy.ndarray": _Array,
    "numpy.dtype": _Type,
    "_codecs.encode": _encode,
    **{f"numpy.{core}.multiarray._reconstruct": _Array for core in ("core", "_core")},
    **{f"numpy.{core}.numeric._frombuffer": _from_buffer for core in ("core", "_core")},
}


class PlainUnpickler(pickle.Unpickler):
    """Python's unpickler without foreign names; arrays come as stand-ins with ``values``."""

    def find_class(self, module: str, name: str) -> Any:
        """Look a name up in a table instead of importing it."""
        if f"{module}.{name}" not in STAND_INS:
            raise ValueError(f"the name {module}.{name}, which no plain data needs")
        return STAND_INS[f"{module}.{name}"]


def read_pickle(path: Path) -> Any:
    """Read numbers, texts, lists, dicts with text keys, and arrays of numbers as lists of lists."""
    with path.open("rb") as file:
        value = PlainUnpickler(file, encoding="latin1").load()
    text = json.dumps(value, default=lambda array: array.values.tolist())
    if len(text) > LONGEST_ANSWER:
        raise ValueError(f"over {LONGEST_ANSWER >> 20} million signs of values")
    return json.loads(text)


if __name__ == "__main__":
    from ggvs_eval.side_process import serve

    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    serve(read_pickle)
