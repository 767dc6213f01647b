"""Engines that run jobs, in processes of this machine or on workers of dask.

The results are the same bits.

In processes of this machine, no more run at once than its memory holds, and again where a process
was killed.
"""

import os
import re
import socket
import sys
import textwrap
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import active_children
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, Literal, TypeVar

from ggvs_eval import built_in
from ggvs_eval.errors import GO_ON, AbsentPartError, RenderError
from ggvs_eval.jobs.machine import has_room
from ggvs_eval.jobs.processes import borrowed_pool, worker_pool
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.plugins import Registry
from ggvs_eval.progress import track
from ggvs_eval.tasks.identity import package_digest

TRIES_ALONE = 2
LOOK_AGAIN_S = 0.5  # while a job waits for memory
STDERR = 2  # its file descriptor
MESSAGE_LETTERS = 300
GUARD = 'a script that starts processes must call its functions below `if __name__ == "__main__":`'
FEWER = "use fewer --jobs, and check the limits of memory and processes (ulimit -a)"
COMMAND_LINE = ("ggvs-eval", "ggvs-eval.exe", "__main__.py")  # the file of the main module
Item = TypeVar("Item")
Result = TypeVar("Result")
Entry = tuple[int, Item]
ENGINES: Registry[Callable[..., Any]] = Registry("engines", built_in.ENGINES)


@dataclass(frozen=True)
class LostJob:
    """Work that took its process with it as often as it was tried.

    Attributes:
        reason: how often, and what to do; one line.
    """

    reason: str


@dataclass(frozen=True)
class Engine:
    """Executor of jobs: the place where they run, and how many run at once.

    Attributes:
        jobs: parallel processes, at least 1.
        engine: processes of this machine, or dask workers (pip install 'ggvs-eval[cluster]').
        scheduler: dask scheduler, tcp://HOST:8786, with shared folders; local workers by default.
    """

    jobs: int = field(default_factory=usable_cpus)
    engine: Literal["processes", "dask"] = "processes"
    scheduler: str | None = None

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item], apart: bool = False
    ) -> Iterator[tuple[int, Result | LostJob]]:
        """Do the work for every item and yield (index, result) in the order in which they end.

        An item whose process dies is done again; one that takes its process with it every time is a
        `LostJob`.

        Args:
            work: a module-level function or a `functools.partial` of one.
            apart: a single item, too, has a process of its own, which it may end.
        """
        if self.jobs < 1:
            raise RenderError(f"--jobs {self.jobs}: wanted at least 1")
        if self.engine == "dask":
            checked = partial(_with_same_code, work, package_digest()) if self.scheduler else work
            on_dask: Iterator[tuple[int, Result | LostJob]] = ENGINES["dask"](
                checked, items, self.jobs, self.scheduler
            )
            return on_dask
        if self.scheduler:
            raise RenderError(
                f"--scheduler {self.scheduler}: wanted --engine dask with it, got processes; add it"
            )

        return run_in_processes(work, items, self.jobs, apart)

    def place(self, path: Path) -> Path:
        """Return a path as every worker understands it: those of dask may work in another
        folder.
        """
        if self.engine == "dask" and (reason := ENGINES.why_absent("dask")):
            raise AbsentPartError(reason)  # before anything is read
        return path.resolve() if self.engine == "dask" else path


def _with_same_code(work: Callable[[Item], Result], code: str, item: Item) -> Result:
    """Do one item on a worker, which must have the caller's code."""
    if code != package_digest():
        raise RenderError(
            f"the worker on {socket.gethostname()} has another version of ggvs-eval; install the "
            f"same"
        )
    return work(item)


Workers = int | Engine  # a number means that many processes of this machine


def as_engine(workers: Workers) -> Engine:
    """Return the engine of N processes, or the engine itself."""
    return Engine(workers) if isinstance(workers, int) else workers


def run_in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int, apart: bool = False
) -> Iterator[tuple[int, Result | LostJob]]:
    """Do the work for every item.

    With one worker, or one item that need not be apart, in this very process.

    A killed process (the kernel's way to say that memory is out) takes the whole pool with it.
    Every item that was in hand is then tried again alone, to find the one that ran out of memory.

    Args:
        work: a module-level function or a `functools.partial` of one.

    Yields:
        (index of an item, what came of it), in the order in which they end.
    """
    if workers == 1 or (len(items) == 1 and not apart):
        yield from ((index, work(item)) for index, item in enumerate(items))
        return
    waiting = deque(enumerate(items))
    while waiting:
        in_hand = yield from _run_pool(work, waiting, workers)
        for index, item in in_hand:
            yield index, _run_alone(work, item)


def _run_pool(
    work: Callable[[Item], Result], waiting: deque[Entry[Item]], workers: int
) -> Generator[tuple[int, Result], None, list[Entry[Item]]]:
    """Work until nothing waits or the pool breaks; return the items in hand then."""
    running: dict[Future[Result], Entry[Item]] = {}
    try:
        with borrowed_pool(min(workers, len(waiting)), workers) as pool:
            while waiting or running:
                while waiting and len(running) < workers and _fits(len(running)):
                    running[pool.submit(work, waiting[0][1])] = waiting[0]
                    waiting.popleft()
                futures, _ = wait(running, LOOK_AGAIN_S, FIRST_COMPLETED)
                for future in futures:
                    result = future.result()
                    yield running.pop(future)[0], result
    except BrokenProcessPool:
        ended = [future for future in running if future.done() and future.exception() is None]
        for future in ended:
            yield running.pop(future)[0], future.result()
    except (Exception, GeneratorExit):
        wait(running)  # kept processes would continue with it during the next task
        raise
    return list(running.values())


def _fits(running: int) -> bool:
    """Return whether another job fits into memory; the first may always run."""
    return running == 0 or has_room(
        running, [child.pid for child in active_children() if child.pid]
    )


def _run_alone(work: Callable[[Item], Result], item: Item) -> Result | LostJob:
    """Try an item in a separate process, which no other item can end.

    Its errors are printed when it has ended.

    Raises:
        RenderError: the process died of an exception that every other process would raise too:
            before the work began, since what the work raises comes back alone.
    """
    exit_code = None
    for _ in range(TRIES_ALONE):
        with TemporaryFile() as errors:
            try:
                with worker_pool(1) as pool:
                    before = active_children()
                    with _errors_into(errors):
                        running = pool.submit(work, item)
                    started = [child for child in active_children() if child not in before]
                    return running.result()
            except BrokenProcessPool:
                exit_code = started[0].exitcode if started else None
            finally:
                errors.seek(0)
                text = errors.read().decode(errors="replace")
                sys.stderr.write(text)
            if exit_code and exit_code > 0 and (reason := last_error(text)):
                raise RenderError(f"worker processes cannot start: {reason}; {start_remedy()}")
    if exit_code and exit_code > 0:
        last = "".join(text.strip().splitlines()[-1:]) or "it printed nothing"
        return LostJob(
            f"its process ended, run alone, {TRIES_ALONE + 1} times, at last with status "
            f"{exit_code} ({last})"
        )
    return LostJob(
        f"its process was killed {TRIES_ALONE + 1} times, at last alone on the machine; it may "
        f"need more memory"
    )


def start_remedy() -> str:
    """Return the advice for processes that do not start: a script can lack its guard."""
    main = getattr(sys.modules["__main__"], "__file__", None) or ""
    return FEWER if os.path.basename(main) in COMMAND_LINE else GUARD


def last_error(text: str) -> str:
    r"""Return the exception that a process ended with, in one line, out of what it printed.

    Empty if it ended with none.

    Examples:
        >>> last_error("Traceback (most recent call last):\n  File ...\nKeyError: 'cam00'\n")
        "KeyError: 'cam00'"
        >>> last_error("a warning")
        ''
    """
    _, traceback, raised = text.rpartition("Traceback (most recent call last):")
    message = re.search(r"^\S.*", raised, re.MULTILINE | re.DOTALL) if traceback else None
    return textwrap.shorten(message[0], MESSAGE_LETTERS, placeholder=" ...") if message else ""


@contextmanager
def _errors_into(file: IO[bytes]) -> Iterator[None]:
    """Let processes that are started inside print their errors into a file."""
    original = os.dup(STDERR)
    os.dup2(file.fileno(), STDERR)
    try:
        yield
    finally:
        os.dup2(original, STDERR)
        os.close(original)


def run_all(
    work: Callable[[Item], object], items: Sequence[Item], workers: Workers, description: str
) -> None:
    """Do the work for every item.

    The first that fails ends it, and a second call does what is missing.

    Args:
        work: writes what is missing of an item; a module-level function or a `functools.partial` of
            one.

    Raises:
        RenderError: the work took its process with it as often as it was tried, or a worker has
            other code than this process.
        Exception: what the work itself raised.
    """
    if not items:
        return
    for _, outcome in track(as_engine(workers).run(work, items), description, len(items)):
        if isinstance(outcome, LostJob):
            raise RenderError(f"{description}: {outcome.reason}; {GO_ON}")
