"""Run folders of one capture and protocol, made on several machines with different methods or views, become one."""

import filecmp
import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.coverage import IMPORT_FILE
from ggvs_eval.depth_options import UNEXPLAINED
from ggvs_eval.errors import GgvsError, ProtocolError, ResultsError
from ggvs_eval.files.atomic import atomic_folder, link_file
from ggvs_eval.jobs.ledger import JOBS_FOLDER
from ggvs_eval.pipelines.run.derived_files import DIGESTS, join_records
from ggvs_eval.pipelines.run.render import FITS
from ggvs_eval.protocol import name_differences
from ggvs_eval.run_folder import JOB_FILE, ON_SCREEN, RunFolder, read_json, write_json

ROUNDING = 1e-6  # machines add in different orders


@dataclass(frozen=True)
class Unit:
    """One piece of a run.

    Attributes:
        name: its path in the run folder.
    """

    name: str
    source: Path

    def files(self) -> list[Path]:
        """Return the file itself, or all files of the folder, without what is being written."""
        return list(_files_below(self.source)) if self.source.is_dir() else [self.source]


def job_units(root: Path, folder: str) -> list[Unit]:
    """Return every folder with the result of a job, or with imported renders, below a folder of a run."""
    imported = sorted(file.parent for file in (root / folder).glob(f"*/{IMPORT_FILE}"))
    jobs = sorted(file.parent for pattern in ("*", "*/*") for file in (root / folder).glob(f"{pattern}/{JOB_FILE}"))
    folders = [*imported, *(job for job in jobs if job.parent not in imported)]
    return [Unit(each.relative_to(root).as_posix(), each) for each in folders if not _is_hidden(each, root)]


def same_unit(one: Unit, other: Unit) -> str:
    """Return why two units of one name are not the same; empty if they are."""
    if one.source.is_file():
        return "" if filecmp.cmp(one.source, other.source, shallow=False) else "they have different bytes"
    for record in (JOB_FILE, IMPORT_FILE):
        files = (one.source / record, other.source / record)
        if all(file.is_file() for file in files):
            return _same_job(one, other, *(read_json(file) for file in files))
    return "one was rendered here and the other imported"


def same_values(one: Any, other: Any) -> bool:
    """Return whether two records say the same, up to the rounding of their numbers."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same_values(one[key], other[key]) for key in one)
    if isinstance(one, Sequence) and isinstance(other, Sequence) and not isinstance(one, str):
        return len(one) == len(other) and all(same_values(*pair) for pair in zip(one, other, strict=True))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=ROUNDING, abs_tol=ROUNDING) or (math.isnan(one) and math.isnan(other))
    return bool(one == other)


def _same_job(one: Unit, other: Unit, record: Mapping[str, Any], other_record: Mapping[str, Any]) -> str:
    if record.get("sha256") != other_record.get("sha256"):
        mine, theirs = record.get("identity", {}), other_record.get("identity", {})
        changed = [name for name in dict.fromkeys([*mine, *theirs]) if mine.get(name) != theirs.get(name)]
        return f"they have other {', '.join(changed) or 'inputs'}"
    if "values" in record and not same_values(record["values"], other_record.get("values")):
        return "their values differ"
    mine_there, theirs_there = ({file.relative_to(unit.source): file for file in unit.files()} for unit in (one, other))
    if mine_there.keys() != theirs_there.keys():
        return "they have different files"
    pictures = [name for name in mine_there if name.name not in (JOB_FILE, IMPORT_FILE)]
    wrong = [name for name in pictures if not filecmp.cmp(mine_there[name], theirs_there[name], shallow=False)]
    return f"{len(wrong)} of {len(pictures)} pictures have different bytes, first {wrong[0]}" if wrong else ""


def _files_below(folder: Path) -> Iterator[Path]:
    for file in sorted(folder.rglob("*")):
        if file.is_file() and not _is_hidden(file, folder):
            yield file


def _is_hidden(path: Path, root: Path) -> bool:
    """Return whether a folder is still being written, whose name is hidden until it is whole."""
    return any(part.startswith(".") for part in path.relative_to(root).parts)


PLAIN_FOLDERS = ("truth", "depth", "disoccluded", "path/truth", "path_depth")
JOB_FOLDERS = ("renders", "path", "path_scores", "ceilings", FITS)
SAME_OF_CAPTURE = ("digests", "cameras", "fps", "n_frames", "units_per_metre", "edit", "layout")
Place = Callable[[Path, Path], object]


def merge_runs(
    out: Path, roots: Sequence[Path], copy: bool = False, finish: Callable[[RunFolder], None] | None = None
) -> RunFolder:
    """Put run folders into a new one; the old ones stay as they are.

    What two runs both have must be the same: captured frames, depth and masks byte by byte, renders of one job picture by
    picture, values of one job up to rounding. The seconds of a job, its fitted scene and those of live depth are those of the
    run that is named first.

    Args:
        out: run folder to make; whole or not at all.
        roots: at least one run folder.
        copy: copy files; otherwise they are linked where the file system can, so that nothing is stored twice.
        finish: what shall be done in the new run before it takes its place.

    Returns:
        The new run, which `ggvs_eval.pipelines.run.score.score` makes the table of.

    Raises:
        ProtocolError: other protocols, captures or ways to find depth; the message says what differs. Or `out` exists.
        ResultsError: no run folder; or two results of one job that differ, both of which are named.
    """
    runs = [RunFolder(root) for root in roots]
    if out.exists():
        raise ProtocolError(f"{out}: wanted a new folder to merge into, got an existing one; choose another")
    _require_alike(runs)
    units = _union([unit for run in runs for unit in _units(run)])
    with atomic_folder(out) as temporary:
        for unit in units.values():
            _place(unit, temporary / unit.name, shutil.copy2 if copy else link_file)
        for record in {file.relative_to(run.root) for run in runs for file in run.root.rglob(DIGESTS)}:
            if (temporary / record).parent.is_dir():
                join_records([run.root / record for run in runs], temporary / record)
        _write_records(runs, temporary)
        merge_scores(runs, temporary)
        if finish is not None:
            try:
                finish(RunFolder(temporary))
            except GgvsError as error:
                raise type(error)(str(error).replace(str(temporary), str(out))) from None
    return RunFolder(out)


def _units(run: RunFolder) -> list[Unit]:
    """Everything that a run is put together from, except for its scores."""
    files = [file for folder in PLAIN_FOLDERS for file in _files_below(run.root / folder)]
    plain = [Unit(file.relative_to(run.root).as_posix(), file) for file in files]
    path = [Unit("path/path.json", run.path_record)] if run.path_record.is_file() else []
    return [*plain, *path, *(unit for folder in JOB_FOLDERS for unit in job_units(run.root, folder))]


def _union(units: Sequence[Unit]) -> dict[str, Unit]:
    """Return each unit once."""
    chosen: dict[str, Unit] = {}
    for unit in units:
        original = chosen.setdefault(unit.name, unit)
        if original is unit or unit.name.startswith(f"{FITS}/"):  # what was rendered from a scene is compared
            continue
        if reason := same_unit(original, unit):
            raise ResultsError(
                f"{original.source} and {unit.source} differ: {reason}; keep one of them, or prepare once and copy truth/ and "
                "depth/ of that run to every machine before rendering"
            )
    return chosen


def _require_alike(runs: Sequence[RunFolder]) -> None:
    """Refuse runs that do not belong in one table."""
    if not runs:
        raise ResultsError("wanted run folders to merge, got none")
    first, *others = runs
    identity = _identity(first)
    for run in others:
        if differences := name_differences(identity, _identity(run)):
            raise ProtocolError(
                f"{first.root} and {run.root} are not runs of one protocol and capture: {differences}; "
                "merge runs that differ in their methods or rendered views alone"
            )


def _identity(run: RunFolder) -> dict[str, Any]:
    """Return the properties that runs must share, by the words that a message uses."""
    record = run.capture_record()
    depth = read_json(run.depth_record) if run.depth_record.is_file() else {}
    return {
        "protocol": run.protocol().values(),
        "capture": {name: record.get(name) for name in SAME_OF_CAPTURE},
        "depth": {name: value for name, value in depth.items() if name not in ("stereo_weights", UNEXPLAINED)},
    }


def _place(unit: Unit, target: Path, place: Place) -> None:
    for file in unit.files():
        destination = target / file.relative_to(unit.source) if unit.source.is_dir() else target
        destination.parent.mkdir(parents=True, exist_ok=True)
        place(file, destination)


def _write_records(runs: Sequence[RunFolder], folder: Path) -> None:
    first = runs[0]
    here = next((run for run in runs if run.capture_path().exists()), first)
    place = here.capture_path().resolve()
    place_record = {"absolute": str(place), "from_run": os.path.relpath(place, folder.resolve())}
    shutil.copy2(first.protocol_file, folder / first.protocol_file.name)
    write_json(folder / "capture.json", here.capture_record() | {"place": place_record})
    for record in ("depth_record", "live_depth_record"):
        files = [file for run in runs if (file := getattr(run, record)).is_file()]
        if files:
            shutil.copy2(files[0], folder / files[0].name)
    write_json(folder / "methods.json", {"labels": list(dict.fromkeys(label for run in runs for label in run.labels()))})
    ledgers = [read_json(file) for run in runs if (file := run.root / JOBS_FOLDER / "render.json").is_file()]
    if ledgers:
        jobs = {name: job for ledger in reversed(ledgers) for name, job in ledger["jobs"].items()}
        write_json(folder / JOBS_FOLDER / "render.json", {"begun_s": min(each["begun_s"] for each in ledgers), "jobs": jobs})


def merge_scores(runs: Sequence[RunFolder], folder: Path) -> None:
    """Write ``scores/<view>/job.json`` with the methods of all runs.

    Raises:
        ResultsError: one method has different values in two runs, or was measured from different frames.
    """
    records: dict[str, list[tuple[Path, dict[str, Any]]]] = {}
    for run in runs:
        for file in sorted(run.scores("").glob(f"*/{JOB_FILE}")):
            records.setdefault(file.parent.name, []).append((file, read_json(file)))
    for view, view_records in records.items():
        methods = _one_record(view_records)
        identity = {label: method["identity"] for label, method in methods.items()}
        sha256 = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        write_json(RunFolder(folder).scores(view) / JOB_FILE, {"sha256": sha256, "identity": identity, "methods": methods})


def _one_record(records: Sequence[tuple[Path, dict[str, Any]]]) -> dict[str, Any]:
    methods: dict[str, Any] = {}
    origin: dict[str, Path] = {}
    for file, record in records:
        for label, method in record["methods"].items():
            original = methods.setdefault(label, method)
            if label.endswith(ON_SCREEN):  # which follows the times, and is measured again where they differ
                continue
            if not same_values(original, method):
                kind = "values" if original["identity"] == method["identity"] else "frames or metrics"
                raise ResultsError(f"{origin[label]} and {file} differ in the {kind} of {label}; keep one of them")
            origin.setdefault(label, file)
    return methods
