"""The pieces that run folders are merged from: single files that every machine has alike, and whole results of jobs."""

import filecmp
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.pipelines.run.coverage import IMPORT_FILE
from ggvs_eval.run_folder import JOB_FILE, read_json

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
        """The file itself, or all files of the folder, without what is being written."""
        return list(_files_below(self.source)) if self.source.is_dir() else [self.source]


def plain_units(root: Path, folder: str) -> list[Unit]:
    """Every file below a folder of a run."""
    return [Unit(file.relative_to(root).as_posix(), file) for file in _files_below(root / folder)]


def job_units(root: Path, folder: str) -> list[Unit]:
    """Every folder with the result of a job, or with imported renders, below a folder of a run."""
    imported = sorted(file.parent for file in (root / folder).glob(f"*/{IMPORT_FILE}"))
    jobs = sorted(file.parent for pattern in ("*", "*/*") for file in (root / folder).glob(f"{pattern}/{JOB_FILE}"))
    folders = [*imported, *(job for job in jobs if job.parent not in imported)]
    return [Unit(each.relative_to(root).as_posix(), each) for each in folders if not _is_hidden(each, root)]


def same_unit(one: Unit, other: Unit) -> str:
    """Return why two units of one name are not the same; empty where they are."""
    if one.source.is_file():
        return "" if filecmp.cmp(one.source, other.source, shallow=False) else "they have different bytes"
    for record in (JOB_FILE, IMPORT_FILE):
        files = (one.source / record, other.source / record)
        if all(file.is_file() for file in files):
            return _same_job(one, other, *(read_json(file) for file in files))
    return "one was rendered here and the other imported"


def same_values(one: Any, other: Any) -> bool:
    """Tell whether two records say the same, up to the rounding of their numbers."""
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
        return f"they were made from other {', '.join(changed) or 'inputs'}"
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
    """Tell whether a folder is still being written, whose name is hidden until it is whole."""
    return any(part.startswith(".") for part in path.relative_to(root).parts)
