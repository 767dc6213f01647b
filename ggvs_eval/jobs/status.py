"""Progress of a run or a sweep: jobs done, in hand, failed and missing, read from its folders alone."""

import os
import time
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.atomic import is_in_hand, scratch_folders
from ggvs_eval.jobs.ledger import STAGES, Entry, Failure, Ledger
from ggvs_eval.progress import duration
from ggvs_eval.run_folder import JOB_FILE

MEBIBYTE = 1 << 20


@dataclass(frozen=True)
class StageStatus:
    """Progress of one stage.

    Attributes:
        done: number of jobs with a result.
        in_hand: names of jobs that a process is working on.
        failed: why jobs failed when they were last tried, and are not tried again now.
        missing: names of jobs that wait.
        left_s: estimate of the time that the rest takes, in seconds; None where nothing runs or nothing is done yet.
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
        raise ResultsError(f"{root}: neither a run nor a sweep in which anything was rendered; begin with `ggvs-eval run`")
    return [_stage_status(ledger, root) for ledger in ledgers]


def describe_status(root: Path) -> str:
    """The same as text: a line per stage, then jobs in hand, failures, and the size of the folder."""
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
    """Read the folder's ledgers, else those of its sweep."""
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
    running = [entry for entry in rest if _is_in_hand(entry)]
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


def _is_in_hand(entry: Entry) -> bool:
    return any(is_in_hand(temporary) for temporary in scratch_folders(entry.folder))


def _left_s(begun_s: float, done: list[Entry], left: int) -> float | None:
    """Estimate the time left at the pace of what was done since the stage was last begun; None if that is nothing."""
    ended_s = [time_s for entry in done if (time_s := (entry.folder / JOB_FILE).stat().st_mtime) >= begun_s]
    return (time.time() - begun_s) / len(ended_s) * left if ended_s else None


def _size(folder: Path) -> int:
    """Bytes of the files below a folder; what is shared by a link counts where it lies."""
    total = 0
    for where, _, files in os.walk(folder):
        for name in files:
            try:
                total += os.lstat(Path(where) / name).st_size
            except OSError:  # just renamed
                continue
    return total
