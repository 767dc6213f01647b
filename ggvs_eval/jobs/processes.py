"""Worker processes that share the CPUs evenly and do not outlive the process that started them."""

import errno
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from multiprocessing import active_children, connection, get_context, parent_process
from types import TracebackType
from typing import Any, TypeVar

from ggvs_eval.kernels import usable_cpus
from ggvs_eval.progress import track

Item = TypeVar("Item")
Made = TypeVar("Made")
# What a /dev/shm that is read-only, full, absent or forbidden makes of a semaphore.
NO_SEMAPHORES = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT, errno.ENOSYS, errno.ENOSPC)


def in_threads(work: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[Made]:
    """Yield what is made of each item, by a thread per CPU: codecs and OpenCV let go of the
    interpreter.
    """
    with ThreadPoolExecutor(usable_cpus()) as pool:
        yield from pool.map(work, items)


def worker_pool(workers: int) -> Executor:
    """Return a pool of fresh processes, each with its share of the CPUs.

    This very process where there can be no other.

    Processes are spawned, not forked: threads and libraries of the parent would not survive a fork.
    """
    threads = max(usable_cpus() // workers, 1)
    try:
        return _WorkerPool(
            workers, get_context("spawn"), initializer=_start_worker, initargs=(threads,)
        )
    except (OSError, NotImplementedError) as error:
        if isinstance(error, OSError) and error.errno not in NO_SEMAPHORES:
            raise
        print(
            f"ggvs-eval: {error or 'no semaphores'} (/dev/shm): running in one process",
            file=sys.stderr,
        )
        return _ThisProcess()


@contextmanager
def kept_workers() -> Iterator[None]:
    """Let everything inside share its processes: to start some for each stage takes as long as a
    short stage.
    """
    global _keeper
    if _keeper is not None:
        yield
        return
    with ExitStack() as stack:
        _keeper = _Keeper(stack)
        try:
            yield
        finally:
            _keeper = None


@contextmanager
def borrowed_pool(workers: int, most: int) -> Iterator[Executor]:
    """Give a pool of N processes: the one that is kept, if any, or a new one that ends with the
    block.
    """
    if _keeper is None:
        with worker_pool(workers) as pool:
            yield pool
    else:
        yield from _keeper.lend(most)


class _Keeper:
    """Keeps one pool until it breaks, and every pool it had until the end of a stack."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self._pools: dict[int, Executor] = {}

    def lend(self, workers: int) -> Iterator[Executor]:
        """Yield a whole pool; one that breaks meanwhile is not lent again."""
        if workers not in self._pools:
            self._pools[workers] = self._stack.enter_context(worker_pool(workers))
        try:
            yield self._pools[workers]
        except BrokenProcessPool:
            del self._pools[workers]
            raise


_keeper: _Keeper | None = None


class _ThisProcess(Executor):
    """Does all work at once, when it is submitted."""

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """See `Executor`."""
        future: Future[Any] = Future()
        try:
            future.set_result(work(*arguments, **named))
        except Exception as error:
            future.set_exception(error)
        return future


class _WorkerPool(ProcessPoolExecutor):
    """A pool that ends at once when its user is interrupted.

    What its workers were filling is swept by the next call.
    """

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Submit work; workers, which may be started here, never see Ctrl-C: it is the parent that
        ends them.
        """
        with _without_interrupts():
            return super().submit(work, *arguments, **named)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> bool | None:
        """Wait for running work; after Ctrl-C end it."""
        if kind in (KeyboardInterrupt, SystemExit):
            for child in active_children():
                child.terminate()
        return super().__exit__(kind, error, trace)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Put Ctrl-C and SIGTERM off until the end.

    A process that is started meanwhile never gets Ctrl-C.

    The mask alone is not enough: another thread may take the signal, and Python would handle it
    here anyway, between the start of a process and sending its input.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    python_handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in python_handlers:
        signal.signal(number, lambda number, _: came.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for number, handler in python_handlers.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])


def finish_all(pool: Executor, running: Sequence[Future[Any]], description: str) -> None:
    """Wait for jobs with a progress bar; the first that fails cancels those not begun.

    Raises:
        Exception: what the job that failed raised.
    """
    try:
        for future in track(as_completed(running), description, total=len(running)):
            future.result()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise


def share_cpus(threads: int) -> None:
    """Give this process its share of the CPUs, before any library starts its own threads."""
    for name in ("OMP_NUM_THREADS", "GGVS_EVAL_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = str(threads)
    import cv2

    cv2.setNumThreads(threads)


def _start_worker(threads: int) -> None:
    share_cpus(threads)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    """A killed parent cannot stop its workers; they would wait for work for ever."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
