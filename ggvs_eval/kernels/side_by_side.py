"""Two pieces of work that need nothing of each other at the same time: where one has a single thread the other fills the gap."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from ggvs_eval.kernels import get_threads

First = TypeVar("First")
Second = TypeVar("Second")


def side_by_side(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """What both return; one after the other if kernels shall use one thread. Errors of either are raised."""
    if get_threads() == 1:
        return first(), second()
    with ThreadPoolExecutor(1) as beside:
        other = beside.submit(second)
        return first(), other.result()
