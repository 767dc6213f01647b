"""D3DMV's ``calib_*.pkl``, read without unpickling: a pickle is a program, and this one is only ever interpreted as data.

A small stack machine that knows lists, dicts with text keys, tuples, numbers, texts, bytes and numpy arrays of numbers. It
imports and calls nothing: names of classes are compared with the few that numpy writes, everything else is refused by its name.
"""

import pickletools
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import CaptureError

LARGEST_FILE_BYTES = 1 << 20
# A calibration of ten cameras takes some 1500 instructions and arrays of 72 bytes; a pickle can copy and repeat what it holds.
MOST_INSTRUCTIONS, MOST_VALUES, MOST_ARRAY_BYTES = 20_000, 20_000, 1 << 12
ARRAY_MAKERS = {"numpy.core.multiarray _reconstruct", "numpy._core.multiarray _reconstruct"}
FROM_BUFFER = {"numpy.core.numeric _frombuffer", "numpy._core.numeric _frombuffer"}
NDARRAY, DTYPE, ENCODE = {"numpy ndarray"}, {"numpy dtype"}, {"_codecs encode"}
NAMES = ARRAY_MAKERS | FROM_BUFFER | NDARRAY | DTYPE | ENCODE
BYTE_ORDERS = "<>|="
KINDS = ("f4", "f8", "i4", "i8", "u1", "u2", "u4", "u8", "i2", "i1")

PUSHED = {"INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"}
PUSHED |= {"STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"}
PUSHED |= {"BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"}
CONSTANTS: dict[str, Any] = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
IGNORED = {"PROTO", "FRAME", "STOP"}
TUPLES = {"EMPTY_TUPLE": 0, "TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


@dataclass(frozen=True)
class _Name:
    """What the pickle would import."""

    name: str


@dataclass
class _Array:
    """An array on its way: made empty, then given its content."""

    values: NDArray[np.generic] | None = None


@dataclass
class _DataType:
    """A type of numbers, such as ``f8``, and its byte order."""

    kind: str
    order: str = "<"


@dataclass
class _Machine:
    """The state of a pickle that is being read."""

    stack: list[Any] = field(default_factory=list)
    marks: list[int] = field(default_factory=list)
    memo: dict[int, Any] = field(default_factory=dict)


def read_plain_pickle(path: Path) -> Any:
    """What a pickle holds, if that is plain data.

    Returns:
        Lists, dicts, tuples, numbers, texts, bytes and arrays.

    Raises:
        CaptureError: absent, too large, cut, or holding anything else, which is named and never run.
    """
    size = path.stat().st_size if path.is_file() else -1
    if not 0 < size <= LARGEST_FILE_BYTES:
        found = "no such file" if size < 0 else f"{size} bytes"
        raise CaptureError(f"{path}: wanted a pickled calibration below {LARGEST_FILE_BYTES >> 20} MiB, got {found}; restore it")
    machine = _Machine()
    try:
        for count, (opcode, argument, _) in enumerate(pickletools.genops(path.read_bytes())):
            if count >= MOST_INSTRUCTIONS:
                raise ValueError(f"more than {MOST_INSTRUCTIONS} instructions")
            _step(machine, opcode.name, argument)
        if len(machine.stack) != 1 or machine.marks:
            raise ValueError(f"{len(machine.stack)} values instead of one")
        return _finished(machine.stack[0], iter(range(MOST_VALUES)))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise CaptureError(f"{path}: wanted a pickle of plain numbers and arrays, got: {reason}; nothing was run") from error


def _step(machine: _Machine, name: str, argument: Any) -> None:
    """Do one instruction."""
    stack = machine.stack
    if name in PUSHED:
        stack.append(argument)
    elif name in CONSTANTS:
        stack.append(CONSTANTS[name])
    elif name in TUPLES:
        stack.append(tuple(_pop(machine, TUPLES[name])))
    elif name == "MARK":
        machine.marks.append(len(stack))
    elif name in ("TUPLE", "LIST", "EMPTY_LIST"):
        items = _pop_to_mark(machine) if name != "EMPTY_LIST" else []
        stack.append(tuple(items) if name == "TUPLE" else items)
    elif name in ("DICT", "EMPTY_DICT"):
        stack.append(_set({}, _pop_to_mark(machine) if name == "DICT" else []))
    elif name in ("APPEND", "APPENDS"):
        items = _pop(machine, 1) if name == "APPEND" else _pop_to_mark(machine)
        _top(machine, list).extend(items)
    elif name in ("SETITEM", "SETITEMS"):
        items = _pop(machine, 2) if name == "SETITEM" else _pop_to_mark(machine)
        _set(_top(machine, dict), items)
    elif name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
        machine.memo[len(machine.memo) if name == "MEMOIZE" else argument] = stack[-1]
    elif name in ("GET", "BINGET", "LONG_BINGET"):
        stack.append(machine.memo[argument])
    elif name not in IGNORED:
        _make(machine, name, argument)


def _make(machine: _Machine, name: str, argument: Any) -> None:
    """The instructions that would import or call something."""
    if name in ("GLOBAL", "STACK_GLOBAL"):
        parts = [argument] if name == "GLOBAL" else _pop(machine, 2)
        wanted = " ".join(part if isinstance(part, str) else "?" for part in parts)
        if wanted not in NAMES:
            raise ValueError(f"the name {wanted.replace(' ', '.')}, which no such calibration needs")
        machine.stack.append(_Name(wanted))
    elif name == "REDUCE":
        function, arguments = _pop(machine, 2)
        machine.stack.append(_call(function, arguments))
    elif name == "BUILD":
        (state,) = _pop(machine, 1)
        _build(machine.stack[-1], state)
    else:
        raise ValueError(f"the instruction {name}, which no such calibration needs")


def _pop(machine: _Machine, count: int) -> list[Any]:
    if len(machine.stack) - (machine.marks[-1] if machine.marks else 0) < count:
        raise ValueError("an instruction without its operands")
    items = machine.stack[len(machine.stack) - count :]
    del machine.stack[len(machine.stack) - count :]
    return items


def _pop_to_mark(machine: _Machine) -> list[Any]:
    start = machine.marks.pop()
    items = machine.stack[start:]
    del machine.stack[start:]
    return items


def _top(machine: _Machine, kind: type) -> Any:
    if not machine.stack or type(machine.stack[-1]) is not kind:
        raise ValueError(f"an instruction that needs a {kind.__name__}")
    return machine.stack[-1]


def _set(target: dict[str, Any], items: list[Any]) -> dict[str, Any]:
    """Keys are texts: hashing a nested tuple could take for ever."""
    if len(items) % 2 or any(type(key) is not str for key in items[::2]):
        raise ValueError("a dict whose keys are no texts")
    target.update(zip(items[::2], items[1::2], strict=True))
    return target


def _call(function: Any, arguments: Any) -> Any:
    """What numpy's own functions would give, for the few that its arrays are pickled with."""
    name = function.name if isinstance(function, _Name) else ""
    if not isinstance(arguments, tuple):
        _refuse(name)
    if name in ARRAY_MAKERS:
        return _Array()
    if name in DTYPE and arguments and isinstance(arguments[0], str) and arguments[0].lstrip(BYTE_ORDERS) in KINDS:
        return _DataType(arguments[0].lstrip(BYTE_ORDERS))
    if name in ENCODE and len(arguments) == 2 and arguments[1] in ("latin1", "latin-1") and isinstance(arguments[0], str):
        return _encoded(arguments[0])
    if name in FROM_BUFFER and len(arguments) == 4:
        content, kind, shape, order = arguments
        return _Array(_array(content, kind, shape, order == "F"))
    return _refuse(name)


def _build(target: Any, state: Any) -> None:
    """Give an array its content, or a type its byte order."""
    if isinstance(target, _Array) and isinstance(state, tuple) and len(state) == 5:
        _, shape, kind, is_fortran, content = state
        target.values = _array(_encoded(content) if isinstance(content, str) else content, kind, shape, is_fortran is True)
    elif isinstance(target, _DataType) and isinstance(state, tuple) and len(state) > 1 and state[1] in tuple(BYTE_ORDERS):
        target.order = state[1]
    else:
        _refuse(type(target).__name__.lstrip("_"))


def _array(content: Any, kind: Any, shape: Any, is_fortran: bool) -> NDArray[np.generic]:
    """An array of numbers; its bytes are there already, so that no claimed shape can ask for more memory."""
    if not isinstance(kind, _DataType) or not isinstance(content, bytes | bytearray) or len(content) > MOST_ARRAY_BYTES:
        raise ValueError(f"an array that is not made of numbers, or of more than {MOST_ARRAY_BYTES} bytes")
    if not isinstance(shape, tuple) or len(shape) > 4 or any(type(length) is not int or length < 0 for length in shape):
        raise ValueError("an array without a shape")
    values = np.frombuffer(content, dtype=np.dtype(kind.order + kind.kind))
    return values.reshape(shape, order="F" if is_fortran else "C")


def _encoded(text: str) -> bytes:
    """Bytes that were pickled as text."""
    if len(text) > MOST_ARRAY_BYTES:
        raise ValueError(f"an array of more than {MOST_ARRAY_BYTES} bytes")
    return text.encode("latin-1")


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"a call of {name.replace(' ', '.') or 'something'} with arguments that numpy does not write")


def _finished(value: Any, budget: Iterator[int], depth: int = 0) -> Any:
    """The value with its arrays in place; four levels are more than a calibration has, and lists may share their items."""
    if next(budget, None) is None:
        raise ValueError(f"more than {MOST_VALUES} values")
    if isinstance(value, _Array):
        if value.values is None:
            raise ValueError("an array without content")
        return value.values
    if isinstance(value, list | tuple | dict) and depth > 4:
        raise ValueError("lists nested more than four deep")
    if isinstance(value, dict):
        return {key: _finished(item, budget, depth + 1) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finished(item, budget, depth + 1) for item in value]
    if isinstance(value, _Name | _DataType):
        raise ValueError("a name where a number was wanted")
    return value
