"""Tasks of a run or a sweep as they are listed with its results, why some failed, and how long the rest takes.

::

    ROOT/jobs/<stage>.json             every task of the stage, by its folder
    ROOT/jobs/failed/<stage>/*.json    why a task failed when it was last tried
"""

import hashlib
import os
import time
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import ResultsError, mendable
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.tasks.task import Made, Result, Task, read_record

JOBS_FOLDER = "jobs"


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
        """Return the name of the task and the reason in one line."""
        return f"{self.name}: {' '.join(self.message.split())}"

    @classmethod
    def of(cls, name: str, error: Exception) -> "Failure":
        """Make the failure of a task from an error; call it while the error is handled."""
        line = mendable(error)
        return cls(name, line) if line else cls(name, f"{type(error).__name__}: {error}", traceback.format_exc())


@dataclass(frozen=True)
class TaskList:
    """The tasks of one stage of a run or a sweep.

    Attributes:
        root: folder of the run or sweep; the folders of tasks are in it, or next to it where runs share them.
        stage: ``fit``, ``render`` or ``score``.
    """

    root: Path
    stage: str

    @property
    def file(self) -> Path:
        """The list of tasks."""
        return self.root / JOBS_FOLDER / f"{self.stage}.json"

    def write(self, tasks: Sequence[Task], keep: bool = False) -> None:
        """Write the list of tasks.

        Args:
            keep: leave in the list what is there for other folders: another shard's, or another sweep's of the same root.
        """
        made = {self._relative(task.folder): vars(task.made) | {"folder": ""} for task in tasks}
        if keep and self.file.is_file():
            made = read_json(self.file)["jobs"] | made
        write_json(self.file, {"begun_s": time.time(), "jobs": made})

    def read(self) -> list[Made]:
        """Read the tasks."""
        made = read_json(self.file)["jobs"].items()
        return [Made(**{**about, "folder": self.root / folder}) for folder, about in made]

    def note(self, made: Made, failure: Failure | None) -> None:
        """Keep why a task failed, or forget it."""
        note = self._note(made)
        if failure is None:
            note.unlink(missing_ok=True)
            return
        write_json(note, {"sha256": made.sha256, **vars(failure)})

    def failure(self, made: Made) -> Failure | None:
        """Return the failure of this very task when it was last tried, or None if it did not fail."""
        try:
            record = read_json(self._note(made))
        except ResultsError:
            return None
        same = record["sha256"] == made.sha256
        return Failure(**{field: record[field] for field in ("name", "message", "traceback")}) if same else None

    def _note(self, made: Made) -> Path:
        name = hashlib.sha256(self._relative(made.batch).encode()).hexdigest()[:16]
        return self.root / JOBS_FOLDER / "failed" / self.stage / f"{name}.json"

    def _relative(self, folder: Path) -> str:
        return Path(os.path.relpath(folder, self.root)).as_posix()


@dataclass(frozen=True)
class Estimate:
    """Time of some results.

    Attributes:
        seconds: of a core, for those that are known.
        unknown: number of files, maps or scenes without an estimate.
    """

    seconds: float
    unknown: int


def estimate(left: Iterable[Result], done: Iterable[Made], pace: Callable[[], float]) -> Estimate:
    """Return the time that results take.

    Args:
        done: results that were made here.
        pace: seconds that a core-second of `Result.cost_s` takes here; called where a cost is used.
    """
    paces = _paces(done)
    seconds, unknown = 0.0, 0
    for result in left:
        word = result.pace or result.kind
        if word in paces:
            seconds += result.count * paces[word]
        elif result.cost_s is not None:
            seconds += result.count * result.cost_s * pace()
        else:
            unknown += result.count
    return Estimate(seconds, unknown)


def _paces(done: Iterable[Made]) -> dict[str, float]:
    """Return the mean seconds of a file for each word of pace."""
    took: dict[str, list[float]] = defaultdict(list)
    for made in done:
        seconds = read_record(made.folder).get("seconds")  # of each stage of each file, or of all together
        if seconds:
            whole = sum(map(sum, seconds.values())) if isinstance(seconds, dict) else seconds
            took[made.pace or made.kind].append(whole / max(made.count, 1))
    return {word: sum(seconds) / len(seconds) for word, seconds in took.items()}
