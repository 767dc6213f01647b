"""Depth maps that a store lacks, and those that it needs no more, by the jobs of a plan."""

from collections.abc import Mapping, Sequence
from contextlib import suppress

from ggvs_eval.depth_store import DepthJob, DepthStore

Instants = Mapping[DepthJob, Sequence[int]]  # of each job, ascending


def depth_left(jobs: Sequence[DepthJob], frames: Sequence[int], store: DepthStore) -> tuple[Instants, Instants]:
    """List the maps that a store lacks of some jobs.

    Returns:
        Those to be found, where a missing check reads them or nothing checks them, and those to be checked.
    """
    found: dict[DepthJob, list[int]] = {}
    checked = {}
    for job in dict.fromkeys(jobs):
        missing = missing_maps(store, job.key, frames)
        if missing and job.checked_with:
            checked[job] = missing
        for each in (job.unchecked, *job.checked_with) if missing else ():
            found[each] = sorted({*found.get(each, ()), *missing_maps(store, each.key, missing)})
    return {job: numbers for job, numbers in found.items() if numbers}, checked


def drop_found(work: Sequence[tuple[Sequence[DepthJob], Sequence[int]]], store: DepthStore) -> None:
    """Remove maps that only checks read, once every check of the jobs is done; `depth_left` then lists none of them.

    Args:
        work: jobs with their instants, of all runs that use the store.
    """
    if any(left for jobs, frames in work for left in depth_left(jobs, frames, store)):
        return
    pairs = [(job, frame) for jobs, frames in work for job in jobs for frame in frames]
    read = {(each.key, frame) for job, frame in pairs if job.checked_with for each in (job.unchecked, *job.checked_with)}
    for key, frame in read.difference((job.key, frame) for job, frame in pairs):
        with suppress(OSError):  # a disk that is read-only keeps it
            store.path(key, frame).unlink()


def missing_maps(store: DepthStore, key: str, frames: Sequence[int]) -> list[int]:
    """Return the instants whose maps of a key a store lacks."""
    return [frame for frame in frames if not store.has(key, frame)]
