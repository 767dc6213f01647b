"""Pickles are read as data: nothing in them runs, and what one claims ends with the process that
reads it.
"""

import pickle
import struct
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.files import pickle_reader
from ggvs_eval.files.pickle_reader import read_pickle
from ggvs_eval.side_process import SideProcess, SideProcessError
from helpers.hostile import Hostile

KERNEL = np.arange(24, dtype=np.float32).reshape(1, 2, 3, 4)
PLAIN = {"trunk": {"kernel": KERNEL}, "steps": [1, 2.5, None, True, "x", 1 << 70]}
# hashed in 2^60 steps
DOUBLED = b")" + b"".join(b"\x94h" + bytes([level]) + b"\x86" for level in range(60))
BOMBS = {
    "memo at a huge index": b"\x80\x04Nr\xff\xff\xff\x7f.",
    "bytes that are not there": b"\x80\x04\x8e" + struct.pack("<Q", 1 << 36) + b"x.",
    "a key that is hashed for ever": b"\x80\x04}" + DOUBLED + b"K\x01s.",
    "lists that share their lists": b"\x80\x04(]"
    + b"".join(b"\x94(" + bytes([104, n]) * 99 + b"l" for n in range(4))
    + b"l.",
    "deep lists": b"\x80\x04" + b"(" * 400_000 + b"l" * 400_000 + b".",
}


class StateOfArray:
    """Pickles as an array with a state of one's choice."""

    def __init__(self, *state: object) -> None:
        self.state = state

    def __reduce__(self):
        return np.empty(0).__reduce__()[0], (np.ndarray, (0,), b"b"), self.state


DAMAGED = [
    *(
        pickle.dumps(StateOfArray(1, shape, np.dtype("f8"), False, b""))
        for shape in ((1 << 40, 1 << 40), ((),))
    ),
    *(
        b"\x80\x04" + rest
        for rest in (
            b"h\x07.",
            b"a.",
            b"\x82\x01.",
            b"U\x01aQ.",
            b"]",
            b"I" + b"9" * 100_000 + b"\n.",
        )
    ),
    *(b"\x80\x09N.", b"no pickle", b""),
    *(pickle.dumps([{"K": np.array([value])}]) for value in (object(), "text")),
    pickle.dumps(np.ndarray),
]


@pytest.fixture(scope="module")
def reader():
    """The process that reads."""
    process = SideProcess(Path(pickle_reader.__file__))
    yield process
    process.end()


@pytest.mark.parametrize("content", DAMAGED, ids=range(len(DAMAGED)))
def test_what_is_damaged_is_refused(content, reader, tmp_path):
    """Cut, of another shape, or no plain data."""
    (tmp_path / "x.pkl").write_bytes(content)
    with pytest.raises(SideProcessError, match=r"\w"):
        reader.ask(tmp_path / "x.pkl", 20)


@pytest.mark.slow
@pytest.mark.parametrize("content", BOMBS.values(), ids=BOMBS)
def test_bombs_end_with_the_process_that_reads_them(content, reader, tmp_path):
    """Memory and time of the one who asks are not taken; the next file is read."""
    (tmp_path / "x.pkl").write_bytes(content)
    with pytest.raises((SideProcessError, TimeoutError)):
        reader.ask(tmp_path / "x.pkl", 3)
    (tmp_path / "x.pkl").write_bytes(pickle.dumps([1]))
    assert reader.ask(tmp_path / "x.pkl", 20) == [1]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_data_comes_back(protocol, tmp_path):
    """Nested dicts and lists, every kind of value, and arrays as lists, in every protocol."""
    (tmp_path / "x.pkl").write_bytes(pickle.dumps(PLAIN, protocol))
    read = read_pickle(tmp_path / "x.pkl")

    assert read["trunk"]["kernel"] == KERNEL.tolist()
    assert read["steps"] == PLAIN["steps"]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_nothing_runs(tmp_path, protocol):
    """A call is refused by its name before it happens, in a list, as an array's content and behind
    a harmless class.
    """
    mark = tmp_path / "mark"
    for value in (
        [Hostile(mark)],
        np.array([Hostile(mark)], dtype=object),
        OrderedDict(a=Hostile(mark)),
    ):
        (tmp_path / "x.pkl").write_bytes(pickle.dumps(value, protocol))
        with pytest.raises(
            ValueError, match=r"the name \S+, which|an array that is not made of numbers"
        ):
            read_pickle(tmp_path / "x.pkl")

    assert not mark.exists()


@pytest.mark.parametrize(
    "target", [b"cnumpy\nndarray\n", b"cnumpy\ndtype\n", b"c_codecs\nencode\n", b"]", b"}"]
)
def test_states_change_no_stand_in(target, tmp_path):
    """A pickle cannot set attributes of what its own or later arrays are made by."""
    (tmp_path / "x.pkl").write_bytes(
        b"\x80\x02" + target + b"}X\x0c\x00\x00\x00__setstate__K\x01sb."
    )
    with pytest.raises((AttributeError, TypeError, ValueError)):
        read_pickle(tmp_path / "x.pkl")
