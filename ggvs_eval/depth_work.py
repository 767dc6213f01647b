"""Depth maps of a store as tasks: maps as they are found, and maps that are checked against
these.
"""

from collections.abc import Iterable, Mapping, Sequence

from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.run_folder import frame_numbers
from ggvs_eval.tasks.task import FileTask, left_of

Instants = Mapping[DepthJob, Sequence[int]]  # of each job, ascending
FOUND, CHECKED = "depth", "checked depth"


def depth_tasks(
    jobs: Iterable[DepthJob], frames: Sequence[int], store: DepthStore
) -> list[FileTask]:
    """Return the depth of some jobs as a store holds it.

    Maps that only checks read may go after these.
    """
    tasks = []
    for job in dict.fromkeys(jobs):
        needs = (job.unchecked, *job.checked_with) if job.checked_with else ()
        searches = [_task(need, frames, store, FOUND) for need in needs]
        tasks.append(_task(job, frames, store, CHECKED if needs else FOUND, searches))
    return tasks


def _task(
    job: DepthJob,
    frames: Sequence[int],
    store: DepthStore,
    kind: str,
    needs: Sequence[FileTask] = (),
) -> FileTask:
    return FileTask(
        name=f"{kind} of {job.camera_name}",
        folder=store.folder(job.key),
        inputs=job.spec,
        files=tuple(store.path(job.key, frame).name for frame in frames),
        kind=kind,
        needs=tuple(needs),
        passes=kind == FOUND,
        addressed=True,
    )


def missing_depth(
    jobs: Sequence[DepthJob], frames: Sequence[int], store: DepthStore
) -> tuple[Instants, Instants]:
    """Return the instants that a store lacks of some jobs: those to be found, and those to be
    checked.
    """
    jobs_by_folder = {
        store.folder(need.key): need
        for job in jobs
        for need in (job, job.unchecked, *job.checked_with)
    }
    instants: dict[str, dict[DepthJob, list[int]]] = {FOUND: {}, CHECKED: {}}
    for task in left_of(depth_tasks(jobs, frames, store)):
        assert isinstance(task, FileTask)
        instants[task.kind][jobs_by_folder[task.folder]] = frame_numbers(task.files)
    return instants[FOUND], instants[CHECKED]
