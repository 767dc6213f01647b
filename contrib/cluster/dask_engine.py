"""Run jobs on dask: a cluster of processes on this machine, or the workers of the user's scheduler
(Slurm, Kubernetes, SSH).
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from importlib import import_module
from threading import Event, Thread
from typing import Any, TypeVar

from ggvs_eval.errors import GO_ON, RenderError
from ggvs_eval.jobs.engine import LostJob, start_remedy
from ggvs_eval.jobs.processes import share_cpus
from ggvs_eval.kernels import usable_cpus

CONNECT_S = 30
REPLACE_EVERY_S = 2.0
HTTP_ROUTES = ("distributed.scheduler.http.routes", "distributed.worker.http.routes")
MISSING = "--engine dask: {}; install it with `pip install ggvs-eval[cluster]`"

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_on_dask(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int, scheduler: str | None
) -> Iterator[tuple[int, Result | LostJob]]:
    """Do the work for every item on dask workers, which may come, die and come back.

    The scheduler gives an item whose worker is gone to another one; after its
    `distributed.scheduler.allowed-failures` deaths it takes the item for their cause, and all that
    waited on the same workers with it: each of these is then tried alone.

    Args:
        work: a module-level function or a `functools.partial` of one, known to the workers.
        workers: processes of the cluster on this machine; of no meaning to a scheduler that is
            given.
        scheduler: address; None starts a cluster on this machine.

    Yields:
        (index of an item, what came of it), in the order in which they end.

    Raises:
        RenderError: dask is not installed, or nothing answers at the address, or the scheduler has
            gone away.
    """
    distributed = _import_distributed()
    threads = None if scheduler else max(usable_cpus() // workers, 1)
    with _connect(distributed, min(workers, len(items)), scheduler) as client:
        futures = [client.submit(_work_on, work, item, threads, pure=False) for item in items]
        index_of = {future.key: index for index, future in enumerate(futures)}
        suspects = []
        try:
            for future in distributed.as_completed(futures):
                outcome, index = _outcome(distributed, future), index_of[future.key]
                if isinstance(outcome, LostJob):
                    suspects.append(index)
                else:
                    yield index, outcome
            for index in suspects:
                alone = client.submit(_work_on, work, items[index], threads, pure=False)
                yield index, _outcome(distributed, alone)
        except (CancelledError, distributed.comm.CommClosedError) as error:
            raise RenderError(f"{scheduler or 'dask'}: the scheduler has gone; {GO_ON}") from error


def _work_on(work: Callable[[Item], Result], item: Item, threads: int | None) -> Result:
    """Runs in a worker; those of another's cluster have the threads that it gave them."""
    if threads is not None:
        share_cpus(threads)
    return work(item)


def _outcome(distributed: Any, future: Any) -> Any:
    """Return the result of a future that has ended; bugs of the package are raised."""
    try:
        return future.result()
    except distributed.KilledWorker as error:
        return LostJob(
            f"its worker died {error.allowed_failures + 1} times; it may need more memory than a "
            f"worker has"
        )


@contextmanager
def _connect(distributed: Any, workers: int, scheduler: str | None) -> Iterator[Any]:
    """A client of the user's scheduler, or of a cluster that ends with it."""
    if scheduler:
        # losses are reported in one line, here
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            client = distributed.Client(scheduler, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise RenderError(
                f"--scheduler {scheduler}: no dask scheduler answers there ({error}); start one"
            ) from error
        with client:
            yield client
        return
    with (
        _local_cluster(distributed, workers) as cluster,
        distributed.Client(cluster) as client,
        _kept_at(workers, cluster),
    ):
        yield client


@contextmanager
def _local_cluster(distributed: Any, workers: int) -> Iterator[Any]:
    """A cluster on this machine that obeys this process alone.

    A scheduler runs code for anyone who can reach it, and other users of this machine reach its
    ports: it and its workers therefore ask for a certificate that exists in their memory only
    (TLS). Their HTTP servers, which cannot be left away, are left without a page.
    """
    import dask

    try:
        security = distributed.Security.temporary()
    except ImportError as error:
        raise RenderError(MISSING.format(error)) from None
    closed = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    with dask.config.set({key: [] for key in HTTP_ROUTES}), ExitStack() as stack:
        try:
            cluster = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address=None,
                security=security,
                scheduler_kwargs=closed,
            )
        except RuntimeError as error:
            raise RenderError(
                f"dask's workers cannot start: {_root(error)}; {start_remedy()}"
            ) from error
        yield stack.enter_context(cluster)


def _root(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


@contextmanager
def _kept_at(workers: int, cluster: Any) -> Iterator[None]:
    """Have the cluster replace workers that it has lost for good.

    A worker that dies is started again; where that takes longer than dask's `lost-worker-timeout`,
    as on a busy machine, dask takes it out of the cluster, and without any worker left every item
    would wait forever.
    """
    ended = Event()

    def replace_lost() -> None:
        while not ended.wait(REPLACE_EVERY_S):
            cluster.scale(workers)

    watch = Thread(target=replace_lost, daemon=True)
    watch.start()
    try:
        yield
    finally:
        ended.set()
        watch.join()


def _import_distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        raise RenderError(MISSING.format(error)) from None
