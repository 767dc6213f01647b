"""Memory of the kernels' results: kept for results of the same size, never shared by two arrays,
never kept without bound.
"""

import gc
import threading

import numpy as np
import pytest

from ggvs_eval.kernels import _core

SIDE = 512  # pixels: a map of 1 MiB, large enough to be kept
MAP_BYTES = 4 * SIDE * SIDE


@pytest.fixture(autouse=True)
def nothing_left():
    """Arrays of other tests are given up before."""
    gc.collect()


def mixed(value: float, width: int = SIDE) -> np.ndarray:
    """A kernel's result that is `value` everywhere."""
    return mixed_of(np.full((SIDE, width), value, np.float32))


def mixed_of(depth: np.ndarray) -> np.ndarray:
    """A kernel's result that is equal to a depth."""
    return _core.mix_depth(depth, depth, depth, 0.05, 1)


def test_memory_of_a_result_that_is_gone_serves_the_next():
    """The next result of the same size lies where the last one lay; one of another size
    does not.
    """
    first = mixed(1.0)
    place, before = first.ctypes.data, _core.idle_bytes()
    del first
    assert _core.idle_bytes() == before + MAP_BYTES
    other = mixed(2.0, SIDE + 32)
    assert other.ctypes.data != place
    second = mixed(3.0)
    assert second.ctypes.data == place
    assert (second == 3).all()
    assert (other == 2).all()


def test_results_that_live_keep_their_memory():
    """Views and slices count as life: nobody writes into what can still be read."""
    row = mixed(1.0)[7]
    later = [mixed(2.0 + n) for n in range(20)]
    assert (row == 1).all()
    assert len({each.ctypes.data for each in later}) == 20
    assert all((each == 2.0 + n).all() for n, each in enumerate(later))


@pytest.mark.slow
def test_what_is_kept_is_bounded():
    """No more stays than was in use at once, or half a gibibyte, and what nobody asked for again
    goes in the end.
    """
    depth = np.ones((SIDE, 120 * SIDE), np.float32)  # 120 MiB
    many = [mixed_of(depth) for _ in range(5)]
    places = {each.ctypes.data for each in many}
    del many
    assert _core.idle_bytes() >= 600 << 20
    again = [mixed_of(depth) for _ in range(5)]
    assert {each.ctypes.data for each in again} == places  # no page is cleared anew
    del again
    assert 600 << 20 <= _core.idle_bytes() <= 640 << 20
    held = [mixed_of(depth[:, : 128 + n].copy()) for n in range(260)]
    assert _core.idle_bytes() < 1 << 24
    assert all((each == 1).all() for each in held)


def test_what_is_idle_can_be_given_back():
    """Scoring that follows rendering begins without its memory; what still lives is not touched."""
    held, given_up = mixed(1.0), mixed(2.0)
    del given_up
    assert _core.idle_bytes() >= MAP_BYTES
    _core.forget_idle()
    assert _core.idle_bytes() == 0
    assert (held == 1).all()


def test_many_threads_share_it():
    """Results of several threads at a time are each their own."""
    wrong = []

    def work(value: float) -> None:
        for _ in range(30):
            if not (mixed(value) == value).all():
                wrong.append(value)

    threads = [threading.Thread(target=work, args=(float(n + 1),)) for n in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert not wrong


def test_an_array_can_be_had_without_a_kernel():
    """`empty` gives float32 of any shape, writable, and refuses what is none."""
    found = _core.empty((3, SIDE, SIDE))
    found[:] = 2
    assert found.shape == (3, SIDE, SIDE)
    assert found.dtype == np.float32
    assert _core.empty((0, 4)).size == 0
    with pytest.raises(ValueError, match="sizes must not be negative"):
        _core.empty((2, -1))
