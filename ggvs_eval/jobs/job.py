"""Jobs: a folder of results that exists whole or not at all, and is made once.

A job's identity is everything its result depends on. Its folder carries a ``job.json`` with that identity, so what exists is not
run again and what was killed is: results are written under a temporary name next to the folder and renamed when complete. Work
that takes hours continues where it was killed: what it has left is kept next to the folder for the same job.
"""

import glob
import hashlib
import json
import shutil
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.errors import RenderError
from ggvs_eval.files.atomic import locked, remove_leftovers, scratch_folder
from ggvs_eval.jobs.engine import Workers, as_engine
from ggvs_eval.jobs.ledger import Entry, Failure, Ledger, LostJob
from ggvs_eval.progress import track
from ggvs_eval.run_folder import JOB_FILE, write_json
from ggvs_eval.tasks.identity import package_digest

UNFINISHED = "unfinished"  # what a job that resumes has left: .<name>.<hash>.unfinished
KEPT_OF_HASH = 16  # digits


@dataclass(frozen=True)
class Job:
    """One piece of work.

    What a job leaves is noted file by file with its size: a result of which some was lost or cut short is made again.

    Attributes:
        name: for people, e.g. ``ours-geometric in cam00``.
        identity: everything the result depends on, as JSON values.
        work: called with a temporary folder to fill; returns what job.json records besides the identity. It travels to another
            process, so it is a module-level function or a `functools.partial` of one.
        resumes: the work continues from what it has left in its folder when it was killed; from which it must determine its
            progress.
        renews: the work keeps a part of the result that is there, so that one process at a time does it. Where all that another
            job had made is kept, the record's ``also`` names that job's hash.
    """

    name: str
    folder: Path
    identity: dict[str, Any]
    work: Callable[[Path], dict[str, Any]]
    resumes: bool = False
    renews: bool = False

    @property
    def sha256(self) -> str:
        """Hash of the identity."""
        return hashlib.sha256(json.dumps(self.identity, sort_keys=True).encode()).hexdigest()

    @property
    def entry(self) -> Entry:
        """The job's entry in a job log."""
        return Entry(self.name, self.folder, self.sha256)

    def is_done(self) -> bool:
        """Return whether the folder holds the result of exactly this job."""
        return self.entry.is_done()

    def run(self) -> None:
        """Do the work and put its result in place."""
        with self._alone(), scratch_folder(self.folder) as scratch, self._workspace(scratch) as temporary:
            if (self.resumes or self.renews) and self.is_done():  # by another process, for which this one waited
                return
            record = self.work(temporary)
            files = {
                file.relative_to(temporary).as_posix(): file.stat().st_size
                for file in sorted(temporary.rglob("*"))
                if file.is_file()
            }
            files.pop(JOB_FILE, None)
            made = {"sha256": self.sha256, "identity": self.identity, "files": files}
            write_json(temporary / JOB_FILE, made | record)
            self._put_in_place(temporary)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Keep other processes from a result that they would renew."""
        if not self.renews:
            yield
            return
        with locked(self.folder):
            try:
                yield
            finally:
                with suppress(OSError):  # it holds a result
                    self.folder.rmdir()

    @contextmanager
    def _workspace(self, scratch: Path) -> Iterator[Path]:
        """The folder to work in: a scratch folder, or one that outlives a kill and that one process at a time works in."""
        if not self.resumes:
            yield scratch
            return
        kept = self.folder.with_name(f".{self.folder.name}.{self.sha256[:KEPT_OF_HASH]}.{UNFINISHED}")
        for other in self.folder.parent.glob(f".{glob.escape(self.folder.name)}.*.{UNFINISHED}"):
            if other != kept:  # of a job that is no longer wanted
                shutil.rmtree(other, ignore_errors=True)
        with locked(kept):
            yield kept

    def _put_in_place(self, temporary: Path) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        try:
            temporary.replace(self.folder)
        except OSError:  # a cluster that lost sight of a worker gave the job to another, which was faster
            if not self.is_done():
                raise


@dataclass(frozen=True)
class Attempt:
    """Outcome of an attempt to run some jobs.

    Attributes:
        done: how many were run to their end; those that were done before do not count.
    """

    done: int
    failures: tuple[Failure, ...]


class BrokenJobError(RuntimeError):
    """Bug of the package in a job; the message ends with its traceback."""


def run_jobs(jobs: Sequence[Job], workers: Workers, description: str, ledger: Ledger | None = None) -> int:
    """Run the jobs that are not done yet; one failure does not stop the others.

    Args:
        workers: where they run; 1 runs them in this process.

    Raises:
        RenderError: jobs failed for a reason that the user can fix; the message lists each.
        BrokenJobError: jobs met a bug of this package; raised when all others are done.
    """
    attempt = attempt_jobs(jobs, workers, description, ledger)
    if not attempt.failures:
        return attempt.done
    broken = [failure.traceback for failure in attempt.failures if failure.traceback]
    listed = "; ".join(map(str, attempt.failures))
    if broken:
        raise BrokenJobError("\n".join([listed, *broken]))
    raise RenderError(f"{len(attempt.failures)} of {attempt.done + len(attempt.failures)} jobs failed: {listed}")


def attempt_jobs(jobs: Sequence[Job], workers: Workers, description: str, ledger: Ledger | None = None) -> Attempt:
    """Run the jobs that are not done yet and return the failures; arguments as of `run_jobs`."""
    open_jobs = [job for job in jobs if not job.is_done()]
    for job in open_jobs:
        remove_leftovers(job.folder)
    if not open_jobs:
        return Attempt(0, ())
    engine = as_engine(workers)
    work = partial(_run_one, code=package_digest() if engine.scheduler else None)
    failures = []
    for index, outcome in track(engine.run(work, open_jobs), description, len(open_jobs)):
        failure = _evaluate(open_jobs[index], outcome)
        if ledger:
            ledger.note(open_jobs[index].entry, failure)
        failures += [failure] if failure else []
        remove_leftovers(open_jobs[index].folder)  # of a worker that died, before another did its job
    return Attempt(len(open_jobs) - len(failures), tuple(failures))


def _run_one(job: Job, code: str | None) -> Failure | None:
    """Run a job; give back why it failed, if it did. What runs on another machine must be the code that the job was made by."""
    try:
        if code is not None and code != package_digest():
            return Failure(job.name, f"the worker on {socket.gethostname()} has another version of ggvs-eval; install the same")
        job.run()
    except Exception as error:
        return Failure.of(job.name, error)
    return None


def _evaluate(job: Job, outcome: Failure | LostJob | None) -> Failure | None:
    """Return the failure of a job, wherever it was noticed, or None if its result is here."""
    if isinstance(outcome, LostJob):
        return Failure(job.name, outcome.reason)
    if outcome is None and not job.is_done():
        return Failure(job.name, f"it ended, and {job.folder} is not here: workers must see the same folders")
    return outcome
