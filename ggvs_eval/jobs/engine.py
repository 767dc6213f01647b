"""Engines that run jobs, in processes of this machine or on workers of dask; the results are the same bits."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

from ggvs_eval import built_in
from ggvs_eval.errors import AbsentPartError, RenderError
from ggvs_eval.jobs.ledger import LostJob
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.plugins import Registry

ENGINES: Registry[Callable[..., Any]] = Registry("engines", built_in.ENGINES)
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Engine:
    """Executor of jobs: the place where they run, and how many run at once.

    Attributes:
        jobs: processes.
        engine: processes of this machine, or workers of dask (install ggvs-eval[cluster]).
        scheduler: address of a dask scheduler, tcp://HOST:8786, whose workers see the same folders; without one `dask` starts
            its own workers on this machine.
    """

    jobs: int = field(default_factory=default_workers)
    engine: Literal["processes", "dask"] = "processes"
    scheduler: str | None = None

    def run(self, work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[tuple[int, Result | LostJob]]:
        """Do the work for every item and yield (index, result) in the order in which they end.

        An item whose process dies is done again; one that takes its process with it every time is a `LostJob`.

        Args:
            work: a module-level function or a `functools.partial` of one.
        """
        if self.jobs < 1:
            raise RenderError(f"--jobs {self.jobs}: wanted at least 1")
        if self.engine == "dask":
            on_dask: Iterator[tuple[int, Result | LostJob]] = ENGINES["dask"](work, items, self.jobs, self.scheduler)
            return on_dask
        if self.scheduler:
            raise RenderError(f"--scheduler {self.scheduler}: processes need none; add --engine dask")
        from ggvs_eval.jobs.process_engine import run_in_processes

        return run_in_processes(work, items, self.jobs)

    def place(self, path: Path) -> Path:
        """A path as every worker understands it: those of dask may work in another folder."""
        if self.engine == "dask" and (reason := ENGINES.why_absent("dask")):
            raise AbsentPartError(reason)  # before anything is read
        return path.resolve() if self.engine == "dask" else path


Workers = int | Engine  # a number means that many processes of this machine


def as_engine(workers: Workers) -> Engine:
    """The engine of so many processes, or the engine itself."""
    return Engine(workers) if isinstance(workers, int) else workers
