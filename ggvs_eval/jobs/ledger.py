"""Job log of a run or a sweep, stored with its results, and its progress: jobs finished, running, failed and missing.

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
from ggvs_eval.files.atomic import is_in_hand, scratch_folders
from ggvs_eval.progress import duration
from ggvs_eval.run_folder import JOB_FILE, read_json, write_json

JOBS_FOLDER = "jobs"
STAGES = ("fit", "render", "score")
MEBIBYTE = 1 << 20


@dataclass(frozen=True)
class Entry:
    """A job as a job log knows it.

    Attributes:
        sha256: of everything the result depends on.
    """

    name: str
    folder: Path
    sha256: str

    def is_done(self) -> bool:
        """Return whether the folder holds the result of exactly this job, and each of its files at its size."""
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
        traceback: of bugs of the package; empty if the user can fix it.
    """

    name: str
    message: str
    traceback: str = ""

    def __str__(self) -> str:
        """Return the name the job and the reason in one line."""
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
        root: folder of the run or sweep; the folders of jobs are in it, or next to it where runs share them.
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


@dataclass(frozen=True)
class StageStatus:
    """Progress of one stage.

    Attributes:
        done: number of jobs with a result.
        in_hand: names of jobs that a process is working on.
        failed: why jobs failed when they were last tried, and are not tried again now.
        missing: names of jobs that wait.
        left_s: estimate of the time that the rest takes, in seconds; None if nothing runs or nothing is done yet.
    """

    stage: str
    done: int
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
    ledgers = _ledgers(root)
    if not ledgers:
        raise ResultsError(f"{root}: wanted a run or a sweep with renders, got neither; start with `ggvs-eval run`")
    return [_stage_status(ledger, root) for ledger in ledgers]


def describe_status(root: Path) -> str:
    """Return the same as text: a line per stage, then jobs in hand, failures, and the size of the folder."""
    lines = []
    for stage in read_status(root):
        counts = f"{stage.done} done, {len(stage.in_hand)} running, {len(stage.failed)} failed, {len(stage.missing)} missing"
        left = "" if stage.left_s is None else f", about {duration(stage.left_s)} left"
        lines.append(f"{stage.stage}: {counts}, {stage.n_bytes / MEBIBYTE:.1f} MiB{left}")
        lines += [f"  running  {name}" for name in stage.in_hand]
        lines += [f"  failed   {failure}" for failure in stage.failed]
        lines += [f"  missing  {name}" for name in stage.missing]
    parts = [f"{item.name} {_size(item) / MEBIBYTE:.1f}" for item in sorted(root.iterdir()) if item.is_dir()]
    return "\n".join([*lines, f"MiB: {', '.join(parts)}"])


def _ledgers(root: Path) -> list[Ledger]:
    """Read the folder's job logs, else those of its sweep."""
    ledgers = []
    for stage in STAGES:
        near = [Ledger(folder, stage) for folder in (root, *root.resolve().parents[:2])]
        ledgers += [ledger for ledger in near if ledger.file.is_file()][:1]
    return ledgers


def _stage_status(ledger: Ledger, root: Path) -> StageStatus:
    begun_s, entries = ledger.read()
    mine = [entry for entry in entries if entry.folder.resolve().is_relative_to(root.resolve())]
    done = [entry for entry in mine if entry.is_done()]
    rest = [entry for entry in mine if entry not in done]
    running = [entry for entry in rest if any(is_in_hand(temporary) for temporary in scratch_folders(entry.folder))]
    failures = {entry: failure for entry in rest if entry not in running and (failure := ledger.failure(entry))}
    missing = [entry for entry in rest if entry not in running and entry not in failures]
    return StageStatus(
        ledger.stage,
        len(done),
        tuple(entry.name for entry in running),
        tuple(failures.values()),
        tuple(entry.name for entry in missing),
        sum(_size(entry.folder) for entry in done),
        _left_s(begun_s, done, len(running) + len(missing)) if running else None,
    )


def _left_s(begun_s: float, done: list[Entry], left: int) -> float | None:
    """Estimate the time left at the pace of what was done since the stage was last begun; None if that is nothing."""
    ended_s = [time_s for entry in done if (time_s := (entry.folder / JOB_FILE).stat().st_mtime) >= begun_s]
    return (time.time() - begun_s) / len(ended_s) * left if ended_s else None


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
