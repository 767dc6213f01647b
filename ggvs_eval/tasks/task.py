"""Tasks: what is made once, and again where it is lost, changed, or made from something else.

A task's inputs are everything that its result depends on. Its folder holds a ``job.json`` with
these and its files, so that what exists is not made again, and what was lost or changed is. `Task`
makes a whole folder: it is filled under a temporary name and renamed. `FileTask` makes files whose
names are known beforehand: each is written whole, and what a killed process has left of them stays.
"""

import glob
import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import KW_ONLY, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.atomic import locked, scratch_folder, write_text
from ggvs_eval.files.digest import digest_files
from ggvs_eval.run_folder import JOB_FILE, read_json, write_json

UNFINISHED = "unfinished"  # what a task that resumes has left: .<name>.<hash>.unfinished
KEPT_OF_HASH = 16  # digits
Status = list[Any]  # size, times and digest of a file
STALE = ""  # in place of a digest: made from something else


@dataclass(frozen=True)
class Result:
    """What is made, by a task or somewhere else.

    Attributes:
        name: for people, e.g. ``ours-geometric in cam00``.
        folder: holds it.
        kind: word that `ggvs_eval.pipelines.methods.stage_costs.stage_of` knows.
        pace: results of one word take as long as each other, file for file; empty for their kind.
        count: how many files, maps or scenes it has.
        cost_s: core-seconds of each at `jobs.machine.pace` 1; None if they are not known.
        n_bytes: of each.
        above: how many folders above its own holds all that is made together with it; 0 if it is
            made alone.
    """

    name: str
    folder: Path
    _: KW_ONLY
    kind: str = ""
    pace: str = ""
    count: int = 1
    cost_s: float | None = None
    n_bytes: float = 0.0
    above: int = 0

    @property
    def batch(self) -> Path:
        """Folder of all that is made together with it."""
        return (self.folder, *self.folder.parents)[self.above]


@dataclass(frozen=True, kw_only=True)
class Made(Result):
    """A result as a list knows it.

    Attributes:
        sha256: hash of everything that it depends on.
    """

    sha256: str

    def is_done(self) -> bool:
        """Return whether the folder holds exactly this result, and each of its files at its
        size.
        """
        record = read_record(self.folder)
        try:
            sizes = {name: (self.folder / name).stat().st_size for name in record["files"]}
        except OSError:
            return False
        return record.get("sha256") == self.sha256 and sizes == record["files"]


@dataclass(frozen=True, kw_only=True)
class Task(Result):
    """Something that is made: a folder that holds all of its result, or none of it.

    Attributes:
        inputs: everything that the result depends on, as JSON values.
        make: called with a temporary folder to fill; returns what job.json records besides the
            inputs. It travels to another process: a module-level function or a `functools.partial`
            of one.
        together: in place of `make`, called with the tasks of one `batch`; yields each with its
            record, as soon as that is known.
        needs: what it reads: made before it, and only where it is not done itself.
        resumes: the work continues from what it has left in its folder when it was killed; from
            that it must find out how far it is.
        joins: other files may lie in the folder, and stay.
        foreign: a plug-in's code does it, which may end its process.
    """

    inputs: Mapping[str, Any]
    make: Callable[[Path], Mapping[str, Any]] | None = None
    together: Callable[[Sequence["Task"]], Iterable[tuple["Task", Mapping[str, Any]]]] | None = None
    needs: tuple["AnyTask", ...] = ()
    resumes: bool = False
    joins: bool = False
    foreign: bool = False

    @cached_property
    def sha256(self) -> str:
        """Hash of the inputs."""
        return digest_inputs(self.inputs)

    @property
    def made(self) -> Made:
        """The task as a list knows it."""
        about = {column.name: getattr(self, column.name) for column in fields(Result)}
        return Made(**about, sha256=self.sha256)

    def is_done(self) -> bool:
        """Return whether the folder holds the result of exactly this task."""
        return self.made.is_done()

    def left(self) -> "Task | None":
        """Return what is left of it; None if nothing."""
        return None if self.is_done() else self

    def run(self) -> None:
        """Do the work and put its result in place."""
        if self.make is None:
            run_batch([self])
            return
        with scratch_folder(self.folder) as scratch, self._workspace(scratch) as temporary:
            if self.resumes and self.is_done():  # by another process, for which this one waited
                return
            self.put(self.make(temporary), temporary)

    def put(self, record: Mapping[str, Any], temporary: Path) -> None:
        """Put a folder that holds the whole result in place, with its record."""
        (temporary / JOB_FILE).unlink(missing_ok=True)
        names = [
            file.relative_to(temporary).as_posix()
            for file in sorted(temporary.rglob("*"))
            if file.is_file()
        ]
        files = {name: (temporary / name).stat().st_size for name in names}
        write_json(
            temporary / JOB_FILE,
            {"sha256": self.sha256, "identity": self.inputs, "files": files, **record},
        )
        if self.joins:
            for name in (*names, JOB_FILE):
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                (temporary / name).replace(self.folder / name)
            return
        if self.is_done():  # by another process, and perhaps in use
            return
        shutil.rmtree(self.folder, ignore_errors=True)
        try:
            temporary.replace(self.folder)
        # a cluster that lost sight of a worker gave the task to another, which was faster
        except OSError:
            if not self.is_done():
                raise

    @contextmanager
    def _workspace(self, scratch: Path) -> Iterator[Path]:
        """Give the folder to work in: a scratch folder, or one that outlives a kill, for one
        process at a time.
        """
        if not self.resumes:
            yield scratch
            return
        unfinished = self.folder.with_name(
            f".{self.folder.name}.{self.sha256[:KEPT_OF_HASH]}.{UNFINISHED}"
        )
        for folder in self.folder.parent.glob(f".{glob.escape(self.folder.name)}.*.{UNFINISHED}"):
            if folder != unfinished:  # of a task that is no longer wanted
                shutil.rmtree(folder, ignore_errors=True)
        with locked(unfinished):
            yield unfinished


@dataclass(frozen=True, kw_only=True)
class FileTask(Result):
    """Files of one folder that are made from the same, each written whole.

    Those that are there stay.

    Attributes:
        inputs: everything that they depend on, as JSON values.
        files: their names.
        make: called with the names of those to make; it writes them into the folder. None for what
            is made by other means.
        needs: what it reads: its files need the files of the same names.
        passes: whether they may go once all that needs them is done.
        addressed: whether the folder is called by the hash of the inputs, so that what is there is
            theirs.
    """

    inputs: Mapping[str, Any]
    files: tuple[str, ...]
    make: Callable[[tuple[str, ...]], object] | None = None
    needs: tuple["FileTask", ...] = ()
    passes: bool = False
    addressed: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "count", len(self.files))

    @cached_property
    def sha256(self) -> str:
        """Hash of the inputs."""
        return digest_inputs(self.inputs)

    def left(self) -> "FileTask | None":
        """Return the task with the files that are missing; None if none are.

        A file without a status was written whole from these inputs by a process that was killed
        then.
        """
        record = read_record(self.folder)
        is_same, files = self.addressed or record.get("sha256") == self.sha256, record["files"]
        missing = [
            name
            for name in self.files
            if not (is_same and _is_whole(self.folder / name, files.get(name)))
        ]
        return self.of(missing) if missing else None

    def of(self, names: Iterable[str]) -> "FileTask":
        """Return the task of some of its files."""
        return replace(self, files=tuple(names))

    def run(self) -> None:
        """Make the files and note them."""
        assert self.make is not None
        if self.addressed:
            self.make(self.files)
            return
        self.begin()
        self.make(self.files)
        self.note()

    def begin(self) -> None:
        """Open the folder: what was made from something else stays until it is replaced, and counts
        as missing.
        """
        with locked(self.folder):
            if read_record(self.folder).get("sha256") == self.sha256:
                return
            self._write({file.name: [STALE] for file in self.folder.iterdir()})

    def note(self) -> None:
        """Note the files, which are there."""
        with locked(self.folder):
            files = read_record(self.folder)["files"]
            for name in self.files:
                if files.get(name, [])[:-1] != _times(self.folder / name):
                    files[name] = _status(self.folder / name)
            self._write(files)

    def _write(self, files: Mapping[str, Status]) -> None:
        record = {"sha256": self.sha256, "identity": self.inputs, "files": files}
        # indented it takes ten times as long
        write_text(self.folder / JOB_FILE, json.dumps(record))


AnyTask = Task | FileTask


def run_batch(tasks: Sequence[Task]) -> None:
    """Do the work of tasks that are made together, or of one alone."""
    first = tasks[0]
    if first.together is None:
        first.run()
        return
    with scratch_folder(first.batch):  # others see that this process is at work on it
        for task, record in first.together(tasks):
            with scratch_folder(task.folder) as temporary:
                task.put(record, temporary)


def left_of(tasks: Iterable[AnyTask]) -> list[AnyTask]:
    """List what is left to make of some tasks, each with what it needs before it.

    What only finished tasks need may be gone. Files of one name need the files of that name. Tasks
    of one folder become one.
    """
    missing: dict[Path, AnyTask] = {}
    for task in tasks:
        left = task.left()
        if left is None:
            continue
        needs = [_of_same_files(need, left) for need in left.needs]
        for part in (*left_of(needs), left):
            missing[part.folder] = _joined(missing.get(part.folder), part)
    return list(missing.values())


def _of_same_files(need: AnyTask, task: AnyTask) -> AnyTask:
    if isinstance(need, FileTask) and isinstance(task, FileTask):
        return need.of(name for name in need.files if name in task.files)
    return need


def _joined(first: AnyTask | None, second: AnyTask) -> AnyTask:
    if isinstance(first, FileTask) and isinstance(second, FileTask):
        return second.of(sorted({*first.files, *second.files}))
    return second


def drop_passing(tasks: Sequence[AnyTask]) -> None:
    """Remove the files that only other tasks need, once all of these are done."""
    if left_of(tasks):
        return
    own_files = {
        task.folder / name for task in tasks if isinstance(task, FileTask) for name in task.files
    }
    needs = [
        need for task in tasks for need in task.needs if isinstance(need, FileTask) and need.passes
    ]
    for file in {need.folder / name for need in needs for name in need.files} - own_files:
        with suppress(OSError):  # a disk that is read-only keeps it
            file.unlink()


def digest_inputs(inputs: Mapping[str, Any]) -> str:
    """SHA-256 of JSON values, in any order of their names."""
    return hashlib.sha256(json.dumps(inputs, sort_keys=True, allow_nan=False).encode()).hexdigest()


def read_record(folder: Path) -> dict[str, Any]:
    """Read the record of a result; empty but for its files if there is none that can be read."""
    try:
        record = read_json(folder / JOB_FILE)
        return {**record, "files": dict(record.get("files", {}))}
    except (ResultsError, TypeError, ValueError):
        return {"files": {}}


def _is_whole(file: Path, status: Status | None) -> bool:
    """Return whether a file is as it was noted; a copy has other times and the same digest.

    While the status is the same, so is the content: writing a file sets a time (ctime) that cannot
    be set back.
    """
    if status is None or not file.is_file():
        return file.is_file()
    return status[:-1] == _times(file) or status[-1] == digest_files([file])


def _status(file: Path) -> Status:
    # times first: what is written meanwhile shows in the next ones
    return [*_times(file), digest_files([file])]


def _times(file: Path) -> list[int]:
    about = file.stat()
    return [about.st_size, about.st_mtime_ns, about.st_ctime_ns]
