"""The ledger of a run or a sweep, beside its results: jobs to do, and failures; `ggvs-eval status` reads it.

::

    ROOT/jobs/<stage>.json             every job of the stage: name, folder, hash
    ROOT/jobs/failed/<stage>/*.json    why a job failed when it was last tried
"""

import hashlib
import os
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import ResultsError, mendable
from ggvs_eval.run_folder import JOB_FILE, read_json, write_json

JOBS_FOLDER = "jobs"
STAGES = ("fit", "render", "score")


@dataclass(frozen=True)
class Entry:
    """A job as a ledger knows it.

    Attributes:
        sha256: of everything the result depends on.
    """

    name: str
    folder: Path
    sha256: str

    def is_done(self) -> bool:
        """Tell whether the folder holds the result of exactly this job, and each of its files at its size."""
        try:
            record = read_json(self.folder / JOB_FILE)
            made = self.sha256 in (record["sha256"], *record.get("also", ()))
            return made and all((self.folder / name).stat().st_size == size for name, size in record.get("files", {}).items())
        except (ResultsError, KeyError, TypeError, OSError):
            return False


@dataclass(frozen=True)
class Failure:
    """Reason why something was not done.

    Attributes:
        traceback: of our own bugs; empty where the user can mend it.
    """

    name: str
    message: str
    traceback: str = ""

    def __str__(self) -> str:
        """Name the job and the reason in one line."""
        return f"{self.name}: {' '.join(self.message.split())}"

    @classmethod
    def of(cls, name: str, error: Exception) -> "Failure":
        """Make the failure of a job from an error; call it while the error is handled."""
        line = mendable(error)
        return cls(name, line) if line else cls(name, f"{type(error).__name__}: {error}", traceback.format_exc())


@dataclass(frozen=True)
class LostJob:
    """A job that took its process with it as often as it was tried.

    Attributes:
        reason: how often, and what to do; one line.
    """

    reason: str


@dataclass(frozen=True)
class Ledger:
    """The jobs of one stage of a run or sweep.

    Attributes:
        root: folder of the run or sweep; the folders of jobs lie in it, or beside it where runs share them.
        stage: one of `STAGES`.
    """

    root: Path
    stage: str

    @property
    def file(self) -> Path:
        """The list of jobs."""
        return self.root / JOBS_FOLDER / f"{self.stage}.json"

    def write(self, entries: Sequence[Entry], keep: bool = False) -> None:
        """Write the list of jobs.

        Args:
            keep: leave in the list what is there for other folders: another shard's, or another sweep's of the same root.
        """
        jobs = {self._relative(each): {"name": each.name, "sha256": each.sha256} for each in entries}
        if keep and self.file.is_file():
            jobs = read_json(self.file)["jobs"] | jobs
        write_json(self.file, {"begun_s": time.time(), "jobs": jobs})

    def read(self) -> tuple[float, list[Entry]]:
        """Read when the stage was begun, in seconds since 1970, and its jobs."""
        record = read_json(self.file)
        entries = [Entry(job["name"], self.root / folder, job["sha256"]) for folder, job in record["jobs"].items()]
        return record["begun_s"], entries

    def note(self, entry: Entry, failure: Failure | None) -> None:
        """Keep why a job failed, or forget it."""
        note = self._note(entry)
        if failure is None:
            note.unlink(missing_ok=True)
            return
        record = {"sha256": entry.sha256, "name": failure.name, "message": failure.message, "traceback": failure.traceback}
        write_json(note, record)

    def failure(self, entry: Entry) -> Failure | None:
        """Return the failure of this very job when it was last tried, or None if it did not fail."""
        try:
            record = read_json(self._note(entry))
        except ResultsError:
            return None
        same = record["sha256"] == entry.sha256
        return Failure(record["name"], record["message"], record["traceback"]) if same else None

    def _note(self, entry: Entry) -> Path:
        name = hashlib.sha256(self._relative(entry).encode()).hexdigest()[:16]
        return self.root / JOBS_FOLDER / "failed" / self.stage / f"{name}.json"

    def _relative(self, entry: Entry) -> str:
        return Path(os.path.relpath(entry.folder, self.root)).as_posix()
