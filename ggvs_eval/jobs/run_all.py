"""Work that writes its results itself, piece by piece, wherever jobs run: frames, depth maps and masks of a run."""

import socket
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from ggvs_eval.errors import RenderError
from ggvs_eval.jobs.code_identity import package_digest
from ggvs_eval.jobs.engine import Workers, as_engine
from ggvs_eval.jobs.ledger import LostJob
from ggvs_eval.progress import track

Item = TypeVar("Item")


def run_all(work: Callable[[Item], None], items: Sequence[Item], workers: Workers, description: str) -> None:
    """Do the work for every item; the first that fails ends it, and a second call does what is missing.

    Args:
        work: writes what is missing of an item; a module-level function or a `functools.partial` of one.

    Raises:
        RenderError: the work took its process with it as often as it was tried, or a worker has other code than this process.
        Exception: what the work itself raised.
    """
    if not items:
        return
    engine = as_engine(workers)
    checked = partial(_do_one, work, package_digest()) if engine.scheduler else work
    for _, outcome in track(engine.run(checked, items), description, len(items)):
        if isinstance(outcome, LostJob):
            raise RenderError(f"{description}: {outcome.reason}; what is done stays, run this again")


def _do_one(work: Callable[[Item], None], code: str, item: Item) -> None:
    """Do one item on a worker, which must have the caller's code."""
    if code != package_digest():
        raise RenderError(f"the worker on {socket.gethostname()} has another version of ggvs-eval; install the same")
    work(item)
