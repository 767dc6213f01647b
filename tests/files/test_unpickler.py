"""Pickles are read as data: nothing in them runs, and none takes more memory or time than its length allows."""

import pickle
import struct
import time
import tracemalloc
from collections import OrderedDict
from contextlib import suppress

import numpy as np
import pytest

from ggvs_eval.files.unpickler import CODES, unpickle_plain
from helpers.hostile import Hostile
from helpers.refusals import refused

KERNEL = np.arange(24, dtype=np.float32).reshape(1, 2, 3, 4)
PLAIN = {"trunk": {"kernel": KERNEL}, "steps": [1, 2.5, None, True, "x", b"y", 1 << 70]}


def op(name):
    """The byte of an instruction."""
    return bytes([CODES[name]])


def doubled_tuple(levels=60):
    """A pickle's instructions that push a tuple of twice a tuple of ...: its hash takes 2^levels steps."""
    return op("EMPTY_TUPLE") + b"".join(op("MEMOIZE") + b"h" + bytes([level]) + op("TUPLE2") for level in range(levels))


MEGABYTE = b"X" + struct.pack("<I", 1 << 20) + b"a" * (1 << 20) + b"q\x00"
LATIN = b"X\x06\x00\x00\x00latin1q\x01"
STRANGE = ("INST", "OBJ", "NEWOBJ", "NEWOBJ_EX", "EXT1", "PERSID", "BINPERSID", "DUP", "FROZENSET", "NEXT_BUFFER")
BOMBS = {
    "memo at a huge index": b"\x80\x04Nr\xff\xff\xff\x7f.",
    "bytes that are not there": b"\x80\x04\x8e" + struct.pack("<Q", 1 << 36) + b"x.",
    "a bytearray that is not there": b"\x80\x05\x96" + struct.pack("<Q", 1 << 36) + b"x.",
    "a frame that is not there": b"\x80\x04\x95" + struct.pack("<Q", 1 << 62) + b"N.",
    "a key that is hashed for ever": b"\x80\x04}" + doubled_tuple() + b"K\x01s.",
    "a text encoded a thousand times": (
        b"\x80\x02(" + MEGABYTE + LATIN + b"c_codecs\nencode\nq\x02" + b"h\x02h\x00h\x01\x86R" * 1000 + b"l."
    ),
    "an array of a petabyte": b"\x80\x02cnumpy\nndarray\n\x8a\x07" + b"\x00" * 6 + b"\x04\x85R.",
    "lists that share their lists": b"\x80\x04(]" + b"".join(b"\x94(" + bytes([104, n]) * 99 + b"l" for n in range(3)) + b"l.",
}


class StateOfArray:
    """Pickles as an array with a state of one's choice."""

    def __init__(self, *state: object) -> None:
        self.state = state

    def __reduce__(self):
        return np.empty(0).__reduce__()[0], (np.ndarray, (0,), b"b"), self.state


DAMAGED = [
    b"\x80\x04" + b"(" * 400_000 + b"l" * 400_000 + b".",
    b"\x80\x04cnumpy\nndarray\n" + doubled_tuple() + b"b.",
    b"\x80\x04" + doubled_tuple() + b"\x8c\x01a\x93.",
    *(pickle.dumps(StateOfArray(1, shape, np.dtype("f8"), False, b"")) for shape in ((1 << 40, 1 << 40), (-1,), ((),))),
    b"\x80\x04I" + b"9" * 100_000 + b"\n.",
    *(b"\x80\x04" + rest for rest in (b"h\x07.", b"a.", b"NNN.", b"(N.", b"\x82\x01.", b"U\x01aQ.", b"]")),
    *(b"\x80\x09N.", b"no pickle", b""),
    *(pickle.dumps([{"K": np.array([value])}]) for value in (object(), "text")),
    pickle.dumps(np.ndarray),
]


@pytest.mark.parametrize("content", DAMAGED, ids=range(len(DAMAGED)))
def test_what_is_damaged_is_refused(content):
    """Deep nesting, claims of huge sizes, hashes without end and every kind of rubbish end at once in a ValueError."""
    began = time.process_time()
    with pytest.raises(ValueError, match=r"\w"):
        unpickle_plain(content)
    assert time.process_time() - began < 5


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_data_comes_back(protocol):
    """Nested dicts and lists, every kind of value, and arrays bit by bit, in every protocol."""
    read = unpickle_plain(pickle.dumps(PLAIN, protocol))

    np.testing.assert_array_equal(read["trunk"]["kernel"], PLAIN["trunk"]["kernel"], strict=True)
    assert read["steps"] == PLAIN["steps"]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_nothing_runs(tmp_path, protocol):
    """A call is refused by its name before it happens, in a list, as an array's content and behind a harmless class."""
    mark = tmp_path / "mark"
    for value in ([Hostile(mark)], np.array([Hostile(mark)], dtype=object), OrderedDict(a=Hostile(mark))):
        with pytest.raises(ValueError, match=r"the name \S+, which|an array that is not made of numbers"):
            unpickle_plain(pickle.dumps(value, protocol))

    assert not mark.exists()


@pytest.mark.parametrize("name", STRANGE)
def test_instructions_that_no_data_needs_are_refused(name):
    """Those that make objects by other ways than a call, name what lies outside, or hash."""
    with pytest.raises(ValueError, match=f"the instruction {name}, which"):
        unpickle_plain(b"\x80\x04(cnumpy\nndarray\n)" + op(name) + b"numpy\nndarray\n.")


@pytest.mark.parametrize("content", BOMBS.values(), ids=BOMBS)
def test_bombs_take_neither_memory_nor_time(content):
    """What a few bytes claim is not believed. Python's own unpickler takes 34 GB for one, and hashes a key for ever."""
    tracemalloc.start()
    began = time.process_time()
    with suppress(ValueError):  # the first is plain data in the end: nothing, noted at a high place
        assert unpickle_plain(content) is None

    assert time.process_time() - began < 10
    assert tracemalloc.get_traced_memory()[1] < 8 << 20
    tracemalloc.stop()


def test_states_reach_nothing_but_arrays():
    """A pickle cannot set attributes of what the unpickler is made of."""
    for target in (b"cnumpy\nndarray\n", b"cnumpy\ndtype\n", b"c_codecs\nencode\n", b"]", b"}"):
        with refused(ValueError, "state"):
            unpickle_plain(b"\x80\x02" + target + b"N}X\x04\x00\x00\x00fillK\x01s\x86b.")
