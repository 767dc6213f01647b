"""Tasks of a run or a sweep as they are listed with its results, and why some of them failed.

::

    ROOT/jobs/<stage>.json             every task of the stage, by its folder
    ROOT/jobs/failed/<stage>/*.json    why a task failed when it was last tried
"""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import Failure, ResultsError
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.tasks.task import Made, Task

JOBS_FOLDER = "jobs"


@dataclass(frozen=True)
class TaskList:
    """The tasks of one stage of a run or a sweep.

    Attributes:
        root: folder of the run or sweep; the folders of tasks are in it, or next to it where runs
            share them.
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

        `keep` leaves what is there for other folders, of another shard or sweep.
        """
        records = {self._relative(task.folder): vars(task.made) | {"folder": ""} for task in tasks}
        if keep and self.file.is_file():
            records = read_json(self.file)["jobs"] | records
        write_json(self.file, {"jobs": records})

    def read(self) -> list[Made]:
        """Read the tasks."""
        records = read_json(self.file)["jobs"].items()
        return [Made(**{**about, "folder": self.root / folder}) for folder, about in records]

    def note(self, result: Made, failure: Failure | None) -> None:
        """Keep why a task failed, or forget it."""
        note = self._note(result)
        if failure is None:
            note.unlink(missing_ok=True)
            return
        write_json(note, {"sha256": result.sha256, **vars(failure)})

    def failure(self, result: Made) -> Failure | None:
        """Return the failure of this very task when it was last tried, or None if it did
        not fail.
        """
        try:
            record = read_json(self._note(result))
        except ResultsError:
            return None
        is_current = record["sha256"] == result.sha256
        return (
            Failure(**{field: record[field] for field in ("name", "message", "traceback")})
            if is_current
            else None
        )

    def _note(self, result: Made) -> Path:
        name = hashlib.sha256(self._relative(result.batch).encode()).hexdigest()[:16]
        return self.root / JOBS_FOLDER / "failed" / self.stage / f"{name}.json"

    def _relative(self, folder: Path) -> str:
        return Path(os.path.relpath(folder, self.root)).as_posix()
