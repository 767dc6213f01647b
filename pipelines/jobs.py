"""Jobs: a folder of results that exists whole or not at all, and is made once.

A job's identity is everything its result depends on. Its folder carries a ``job.json`` with that identity, so what exists is not
run again and what was killed is: results are written under a temporary name beside the folder and renamed when complete.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import ggvs_eval
from ggvs_eval.errors import GgvsError, RenderError, ResultsError
from ggvs_eval.processes import worker_pool
from ggvs_eval.progress import track
from ggvs_eval.run_folder import JOB_FILE, read_json, write_json


@dataclass(frozen=True)
class Job:
    """One piece of work.

    Attributes:
        name: for people, e.g. ``ours-geometric in cam00``.
        folder: where its result goes.
        identity: everything the result depends on, as JSON values.
        work: called with a temporary folder to fill; returns what job.json shall say beside the identity. It travels to another
            process, so it is a module-level function or a `functools.partial` of one.
    """

    name: str
    folder: Path
    identity: dict[str, Any]
    work: Callable[[Path], dict[str, Any]]

    @property
    def sha256(self) -> str:
        """Hash of the identity."""
        return hashlib.sha256(json.dumps(self.identity, sort_keys=True).encode()).hexdigest()

    def is_done(self) -> bool:
        """Whether the folder holds the result of exactly this job."""
        try:
            return bool(read_json(self.folder / JOB_FILE)["sha256"] == self.sha256)
        except (ResultsError, KeyError, TypeError):
            return False

    def run(self) -> None:
        """Do the work and put its result in place."""
        temporary = self.folder.with_name(f".{self.folder.name}.{os.getpid()}.tmp")
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        try:
            record = self.work(temporary)
            write_json(temporary / JOB_FILE, {"sha256": self.sha256, "identity": self.identity, **record})
            shutil.rmtree(self.folder, ignore_errors=True)
            temporary.replace(self.folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def run_jobs(jobs: Sequence[Job], workers: int, description: str) -> int:
    """Run what is not done yet; one failure does not stop the others.

    Args:
        jobs: in the order in which they are started.
        workers: processes; 1 runs them in this one.
        description: for the progress bar.

    Returns:
        How many jobs were run.

    Raises:
        RenderError: jobs failed for a reason that the user can mend; the message lists each. Our own bugs are raised as they are.
    """
    open_jobs = [job for job in jobs if not job.is_done()]
    for job in open_jobs:
        _sweep_leftovers(job.folder)
    if not open_jobs:
        return 0
    if workers == 1 or len(open_jobs) == 1:
        failures = [failure for job in track(open_jobs, description) if (failure := _run_one(job))]
    else:
        failures = _run_in_pool(open_jobs, workers, description)
    if failures:
        raise RenderError(f"{len(failures)} of {len(open_jobs)} jobs failed: " + "; ".join(failures))
    return len(open_jobs)


@cache
def code_digest(*packages: str) -> str:
    """Hash of the source and compiled code of sub-packages, so that changed code means a changed job.

    Args:
        packages: importable names, e.g. ``ggvs_eval.geometry``.
    """
    import importlib

    digest = hashlib.sha256(ggvs_eval.__name__.encode())
    for name in packages:
        folder = Path(str(importlib.import_module(name).__file__)).parent
        for file in sorted(folder.rglob("*")):
            if file.suffix in {".py", ".so", ".pyd"}:
                digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()


def _run_one(job: Job) -> str | None:
    """Run a job; give back what the user must mend, if anything."""
    try:
        job.run()
    except GgvsError as error:
        return f"{job.name}: {error}"
    return None


def _run_in_pool(jobs: Sequence[Job], workers: int, description: str) -> list[str]:
    """Run jobs in worker processes."""
    with worker_pool(min(workers, len(jobs))) as pool:
        futures: list[Future[str | None]] = [pool.submit(_run_one, job) for job in jobs]
        return [failure for done in track(as_completed(futures), description, len(jobs)) if (failure := done.result())]


def _sweep_leftovers(folder: Path) -> None:
    """Remove what killed runs of the same job left beside its folder."""
    for leftover in folder.parent.glob(f".{folder.name}.*.tmp"):
        shutil.rmtree(leftover, ignore_errors=True)
