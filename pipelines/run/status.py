"""Status of a run or a sweep: tasks that are finished, running, failed and missing, from the lists
of its stages.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import Failure, ResultsError
from ggvs_eval.files.atomic import is_in_hand, scratch_folders
from ggvs_eval.jobs.machine import estimate
from ggvs_eval.progress import duration
from ggvs_eval.tasks.task import Made
from ggvs_eval.tasks.task_list import TaskList

STAGES = ("fit", "render", "score")
MEBIBYTE = 1 << 20


@dataclass(frozen=True)
class StageStatus:
    """Progress of one stage.

    Attributes:
        n_done: number of tasks with a result.
        in_hand: names of tasks that a process is working on.
        failed: why tasks failed when they were last tried, and are not tried again now.
        missing: names of tasks that wait.
        left_s: estimate of the time that the rest takes, in seconds; None if nothing runs or
            nothing is done yet.
    """

    stage: str
    n_done: int
    in_hand: tuple[str, ...]
    failed: tuple[Failure, ...]
    missing: tuple[str, ...]
    n_bytes: int
    left_s: float | None


def read_status(root: Path) -> list[StageStatus]:
    """Status of every stage that was begun.

    Args:
        root: folder of a run or a sweep, or of a run in a sweep.
    """
    lists = _lists(root)
    if not lists:
        raise ResultsError(
            f"{root}: wanted a run or a sweep with renders, got neither; start with `ggvs-eval run`"
        )
    return [_stage_status(task_list, root) for task_list in lists]


def describe_status(root: Path) -> str:
    """Return the same as text: a line per stage, then tasks in hand, failures, and the size of the
    folder.
    """
    lines = []
    for stage in read_status(root):
        counts = (
            f"{stage.n_done} done, {len(stage.in_hand)} running, {len(stage.failed)} failed, "
            f"{len(stage.missing)} missing"
        )
        left = "" if stage.left_s is None else f", about {duration(stage.left_s)} left"
        lines.append(f"{stage.stage}: {counts}, {stage.n_bytes / MEBIBYTE:.1f} MiB{left}")
        lines += [f"  running  {name}" for name in stage.in_hand]
        lines += [f"  failed   {failure}" for failure in stage.failed]
        lines += [f"  missing  {name}" for name in stage.missing]
    parts = [
        f"{item.name} {_size(item) / MEBIBYTE:.1f}"
        for item in sorted(root.iterdir())
        if item.is_dir()
    ]
    return "\n".join([*lines, f"MiB: {', '.join(parts)}"])


def _lists(root: Path) -> list[TaskList]:
    """Return the folder's lists, else those of its sweep."""
    lists = []
    for stage in STAGES:
        near = [TaskList(folder, stage) for folder in (root, *root.resolve().parents[:2])]
        lists += [task_list for task_list in near if task_list.file.is_file()][:1]
    return lists


def _stage_status(task_list: TaskList, root: Path) -> StageStatus:
    batches: dict[Path, list[Made]] = {}
    for result in task_list.read():
        if result.folder.resolve().is_relative_to(root.resolve()):
            batches.setdefault(result.batch, []).append(result)
    finished = {
        folder for folder, batch in batches.items() if all(result.is_done() for result in batch)
    }
    running = {
        folder
        for folder in batches.keys() - finished
        if any(map(is_in_hand, scratch_folders(folder)))
    }
    waiting = [folder for folder in batches if folder not in finished | running]
    failures = {
        folder: failure for folder in waiting if (failure := task_list.failure(batches[folder][0]))
    }
    missing = [folder for folder in waiting if folder not in failures]
    left = [
        result
        for folder in (*running, *missing)
        for result in batches[folder]
        if not result.is_done()
    ]
    work = estimate(left, [result for folder in finished for result in batches[folder]])
    return StageStatus(
        stage=task_list.stage,
        n_done=len(finished),
        in_hand=tuple(batches[folder][0].name for folder in batches if folder in running),
        failed=tuple(failures.values()),
        missing=tuple(batches[folder][0].name for folder in missing),
        n_bytes=sum(map(_size, finished)),
        left_s=work.seconds / len(running) if running and not work.unknown else None,
    )


def _size(folder: Path) -> int:
    """Return the bytes of the files below a folder; linked files count where they are stored."""
    total = 0
    for where, _, files in os.walk(folder):
        for name in files:
            try:
                total += os.lstat(Path(where) / name).st_size
            except OSError:  # just renamed
                continue
    return total
