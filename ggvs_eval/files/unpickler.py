"""Read a pickle as data: lists, dicts with text keys, tuples, numbers, texts, bytes and numpy arrays of numbers, nothing else.

A pickle is a program. An allow-list of names (`find_class`) keeps foreign code from running, but not a file of nine bytes from
filling the memory (the C unpickler's table of memos grows to any index that is claimed), nor one of two hundred from being hashed
for ever (a key of tuples of twice the same tuple). So instructions are on an allow-list too, those that call, fill or hash are
defined here, and the others are those of Python's unpickler in pure Python, whose memos are a dict.
"""

import io
import pickle
import pickletools
import struct
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, ClassVar, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

MOST_VALUES = 20_000  # a pickle can repeat what it holds
DEEPEST = 4  # lists in lists
MOST_AXES = 4
BYTE_ORDERS = ("<", ">", "|", "=")
KINDS = ("f4", "f8", "i4", "i8", "u1", "u2", "u4", "u8", "i2", "i1")
NUMBERS = ("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT", "NONE", "NEWTRUE", "NEWFALSE")
TEXTS = ("STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8")
BYTES = ("BINBYTES", "SHORT_BINBYTES", "BINBYTES8")
LISTS = ("MARK", "EMPTY_LIST", "LIST", "APPEND", "APPENDS", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_DICT")
MEMOS = ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE", "GET", "BINGET", "LONG_BINGET")
AS_IN_PYTHON = (*NUMBERS, *TEXTS, *BYTES, *LISTS, *MEMOS, "GLOBAL", "STACK_GLOBAL", "PROTO", "FRAME", "STOP")
ERRORS = (
    *(ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError, EOFError, BufferError),
    *(struct.error, pickle.UnpicklingError),
)
CODES = {opcode.name: ord(opcode.code) for opcode in pickletools.opcodes}


def unpickle_plain(content: bytes) -> Any:
    """Unpickle plain data, and nothing else.

    Args:
        content: of the file. Memory and time grow with its length, regardless of what it claims: up to about 100 bytes per byte.

    Returns:
        Lists (tuples among them), dicts, numbers, texts, bytes and arrays.

    Raises:
        ValueError: cut, damaged, or holding anything else, which is named and never run.
    """
    unpickler = _PlainUnpickler(content)
    try:
        value = unpickler.load()
        if unpickler.stack or unpickler.metastack:
            raise ValueError("more than one value")
        return _finished(value, iter(range(MOST_VALUES)))
    except ERRORS as error:
        raise ValueError(" ".join(str(error).split())[:160] or type(error).__name__) from error


def _refuse_instruction(name: str, _: object) -> NoReturn:
    raise ValueError(f"the instruction {name}, which no plain data needs")


def _refuse_call(*_: object) -> NoReturn:
    raise ValueError("a call that numpy does not write")


class _DataType:
    """A type of numbers, such as ``f8``, and its byte order."""

    def __init__(self, kind: Any, *_: Any) -> None:
        text = kind.lstrip("".join(BYTE_ORDERS)) if isinstance(kind, str) else ""
        if text not in KINDS:
            raise ValueError("an array that is not made of numbers")
        self.kind, self.order = text, "<"

    def fill(self, state: Any) -> None:
        """Take the byte order."""
        if not isinstance(state, tuple) or len(state) < 2 or state[1] not in BYTE_ORDERS:
            raise ValueError("a type of numbers without a byte order")
        self.order = state[1]


class _Array:
    """An array on its way: made empty, then given its content."""

    values: NDArray[np.generic] | None = None

    def __init__(self, *_: Any) -> None:
        """Ignore class and shape: both come again with the content."""

    def fill(self, state: Any) -> None:
        """Take shape, type and content."""
        _, shape, kind, is_fortran, content = state
        content = content.encode("latin-1") if isinstance(content, str) else content
        self.values = _numbers(content, kind, shape, "F" if is_fortran is True else "C")


class _PlainUnpickler(pickle._Unpickler):
    """Python's unpickler without all that could run, fill or take without end."""

    # Of the base class; its stub does not name them.
    read: Callable[[int], bytes]
    stack: list[Any]
    metastack: list[list[Any]]
    pop_mark: Callable[[], list[Any]]

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content), encoding="latin1")
        self.encodable = len(content)  # signs; a text is encoded once, and a pickle can ask for it a thousand times

    def find_class(self, module: str, name: str) -> Any:
        """Look a global up in a table instead of importing it."""
        makers = {
            "numpy.core.multiarray._reconstruct": _Array,
            "numpy._core.multiarray._reconstruct": _Array,
            "numpy.core.numeric._frombuffer": _from_buffer,
            "numpy._core.numeric._frombuffer": _from_buffer,
            "numpy.ndarray": _refuse_call,
            "numpy.dtype": _DataType,
            "_codecs.encode": self._encode,
        }
        if f"{module}.{name}" not in makers:
            raise ValueError(f"the name {module}.{name}, which no plain data needs")
        return makers[f"{module}.{name}"]

    def _encode(self, text: Any, encoding: Any) -> bytes:
        """Return the bytes that were pickled as text."""
        if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
            raise ValueError("a text in another encoding than bytes are pickled in")
        self.encodable -= len(text)
        if self.encodable < 0:
            raise ValueError("more bytes than the file has")
        return text.encode("latin-1")

    def _call(self) -> None:
        arguments = self.stack.pop()
        if not callable(self.stack[-1]) or not isinstance(arguments, tuple):
            raise ValueError("a call of something that is no function")
        self.stack[-1] = self.stack[-1](*arguments)

    def _fill(self) -> None:
        state = self.stack.pop()
        if not isinstance(self.stack[-1], _Array | _DataType):
            raise ValueError("a state of something that has none")
        self.stack[-1].fill(state)

    def _set_item(self) -> None:
        items = [self.stack.pop(), self.stack.pop()][::-1]
        _set(self.stack[-1], items)

    def _set_items(self) -> None:
        items = self.pop_mark()
        _set(self.stack[-1], items)

    def _make_dict(self) -> None:
        items = self.pop_mark()
        self.stack.append(_set({}, items))

    def _take_bytearray(self) -> None:
        """Read without allocating the claimed number of bytes."""
        (size,) = struct.unpack("<Q", self.read(8))
        self.stack.append(bytearray(self.read(size)))

    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = {
        **{code: partial(_refuse_instruction, f"{code:#x}") for code in range(256)},
        **{code: partial(_refuse_instruction, name) for name, code in CODES.items()},
        **{CODES[name]: pickle._Unpickler.dispatch[CODES[name]] for name in AS_IN_PYTHON},
        **{CODES["REDUCE"]: _call, CODES["BUILD"]: _fill, CODES["DICT"]: _make_dict, CODES["BYTEARRAY8"]: _take_bytearray},
        **{CODES["SETITEM"]: _set_item, CODES["SETITEMS"]: _set_items},
    }


def _set(target: Any, items: list[Any]) -> dict[str, Any]:
    """Fill a dict; its keys are texts, because hashing a nested tuple could take for ever."""
    if type(target) is not dict or len(items) % 2 or any(type(key) is not str for key in items[::2]):
        raise ValueError("a dict whose keys are no texts")
    target.update(zip(items[::2], items[1::2], strict=True))
    return target


def _from_buffer(content: Any, kind: Any, shape: Any, order: Any) -> _Array:
    array = _Array()
    array.values = _numbers(content, kind, shape, "F" if order == "F" else "C")
    return array


def _numbers(content: Any, kind: Any, shape: Any, order: Literal["C", "F"]) -> NDArray[np.generic]:
    """Return an array of numbers; its bytes are there already, so that no claimed shape can ask for more memory."""
    if not isinstance(kind, _DataType) or not isinstance(content, bytes | bytearray):
        raise ValueError("an array that is not made of numbers")
    if not isinstance(shape, tuple) or len(shape) > MOST_AXES or any(type(length) is not int or length < 0 for length in shape):
        raise ValueError("an array without a shape")
    return np.frombuffer(content, dtype=np.dtype(kind.order + kind.kind)).reshape(shape, order=order)


def _finished(value: Any, budget: Iterator[int], depth: int = 0) -> Any:
    """Return the value with its arrays in place; lists may share their items, so that few of them can represent very many."""
    if next(budget, None) is None:
        raise ValueError(f"more than {MOST_VALUES} values")
    if isinstance(value, _Array) and value.values is not None:
        return value.values
    if isinstance(value, list | tuple | dict) and depth > DEEPEST:
        raise ValueError(f"lists nested more than {DEEPEST} deep")
    if isinstance(value, dict):
        return {key: _finished(item, budget, depth + 1) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finished(item, budget, depth + 1) for item in value]
    if value is None or isinstance(value, int | float | str | bytes | bytearray):
        return value
    raise ValueError("a name or half an array where a value was wanted")
