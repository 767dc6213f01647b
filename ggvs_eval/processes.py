"""Worker processes that share the CPUs evenly and do not outlive whoever started them."""

import os
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import connection, get_context, parent_process


def default_workers() -> int:
    """Processes that suit this machine: one per CPU that we may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def worker_pool(workers: int) -> ProcessPoolExecutor:
    """A pool of fresh processes, each with its share of the CPUs.

    Processes are spawned, not forked: threads and libraries of the parent would not survive a fork.

    Args:
        workers: number of processes.
    """
    threads = max(default_workers() // workers, 1)
    return ProcessPoolExecutor(workers, get_context("spawn"), initializer=_start_worker, initargs=(threads,))


def _start_worker(threads: int) -> None:
    """Share the CPUs before any library starts threads of its own, and watch the parent."""
    for name in ("OMP_NUM_THREADS", "GGVS_EVAL_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = str(threads)
    import cv2

    cv2.setNumThreads(threads)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    """A killed parent cannot stop its workers; they would wait for work for ever."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
