"""Run tasks, and list what came of them: one failure does not stop the others."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import Failure, RenderError
from ggvs_eval.files.atomic import remove_leftovers
from ggvs_eval.jobs.engine import LostJob, Workers, as_engine, run_all
from ggvs_eval.progress import track
from ggvs_eval.tasks.task import AnyTask, FileTask, Task, left_of, run_batch
from ggvs_eval.tasks.task_list import TaskList


@dataclass(frozen=True)
class Attempt:
    """How many tasks were run to their end, and why others were not.

    Those that were done before do not count.
    """

    n_done: int
    failures: tuple[Failure, ...]


class BrokenTaskError(RuntimeError):
    """Bug of the package in a task; the message ends with its traceback."""


def run_tasks(
    tasks: Sequence[Task], workers: Workers, description: str, task_list: TaskList | None = None
) -> int:
    """Run the tasks that are not done yet; one failure does not stop the others.

    Args:
        workers: where they run; 1 runs them in this process.

    Raises:
        RenderError: tasks failed for a reason that the user can fix; the message lists each.
        BrokenTaskError: tasks met a bug of this package; raised when all others are done.
    """
    attempt = attempt_tasks(tasks, workers, description, task_list)
    if not attempt.failures:
        return attempt.n_done
    broken = [failure.traceback for failure in attempt.failures if failure.traceback]
    listed = "; ".join(map(str, attempt.failures))
    if broken:
        raise BrokenTaskError("\n".join([listed, *broken]))
    raise RenderError(
        f"{len(attempt.failures)} of {attempt.n_done + len(attempt.failures)} jobs failed: {listed}"
    )


def attempt_tasks(
    tasks: Sequence[Task], workers: Workers, description: str, task_list: TaskList | None = None
) -> Attempt:
    """Run the tasks that are not done yet and return the failures; arguments as of `run_tasks`."""
    batches: dict[Path, list[Task]] = {}
    for task in tasks:
        if not task.is_done():
            batches.setdefault(task.batch, []).append(task)
    for folder in batches:
        remove_leftovers(folder)
    if not batches:
        return Attempt(0, ())
    waiting, failures = list(batches.values()), []
    apart = any(task.foreign for batch in waiting for task in batch)
    for index, outcome in track(
        as_engine(workers).run(_run_one, waiting, apart), description, len(waiting)
    ):
        batch = waiting[index]
        failure = _evaluate(batch, outcome)
        if task_list:
            task_list.note(batch[0].made, failure)
        failures += [failure] if failure else []
        remove_leftovers(batch[0].batch)  # of a worker that died, before another did its work
    return Attempt(len(batches) - len(failures), tuple(failures))


def make_files(tasks: Sequence[AnyTask], workers: Workers, description: str) -> None:
    """Make the files that are missing; the first failure ends it, and a second call does the rest.

    Raises:
        RenderError: the work took its process with it as often as it was tried.
        Exception: what the work itself raised.
    """
    missing = [task for task in left_of(tasks) if isinstance(task, FileTask)]
    run_all(FileTask.run, missing, workers, description)


def _run_one(batch: Sequence[Task]) -> Failure | None:
    try:
        run_batch(batch)
    except Exception as error:
        return Failure.of(batch[0].name, error)
    return None


def _evaluate(batch: Sequence[Task], outcome: Failure | LostJob | None) -> Failure | None:
    """Return the failure of a batch, wherever it was noticed, or None if its results are here."""
    task = batch[0]
    if isinstance(outcome, LostJob):
        return Failure(task.name, outcome.reason)
    if outcome is None and not all(member.is_done() for member in batch):
        return Failure(
            task.name, f"it ended, and {task.batch} is not here: workers must see the same folders"
        )
    return outcome
