"""Run folders of one capture and protocol, made on several machines with different methods or
views, become one.
"""

import filecmp
import math
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.depth_options import UNEXPLAINED
from ggvs_eval.errors import GgvsError, ProtocolError, ResultsError
from ggvs_eval.files.atomic import atomic_folder, link_file
from ggvs_eval.pipelines.run.render import FITS
from ggvs_eval.protocol import name_differences
from ggvs_eval.run_folder import JOB_FILE, ON_SCREEN, RunFolder, read_json, write_json
from ggvs_eval.tasks.task import read_record
from ggvs_eval.tasks.task_list import JOBS_FOLDER

ROUNDING = 1e-6  # machines add in different orders
NOT_MERGED = ("report", "first_frames", "depth_page")


def same_values(first: Any, second: Any) -> bool:
    """Return whether two records say the same, up to the rounding of their numbers."""
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return first.keys() == second.keys() and all(
            same_values(first[key], second[key]) for key in first
        )
    if isinstance(first, Sequence) and isinstance(second, Sequence) and not isinstance(first, str):
        return len(first) == len(second) and all(
            same_values(*pair) for pair in zip(first, second, strict=True)
        )
    if isinstance(first, float) and isinstance(second, float):
        return math.isclose(first, second, rel_tol=ROUNDING, abs_tol=ROUNDING) or (
            math.isnan(first) and math.isnan(second)
        )
    return bool(first == second)


FILES = ("path/path.json",)  # made by no task, and the same in runs of one protocol
SAME_OF_CAPTURE = ("digests", "cameras", "fps", "n_frames", "units_per_metre", "edit", "layout")
Place = Callable[[Path, Path], object]


def merge_runs(
    out: Path,
    roots: Sequence[Path],
    copy: bool = False,
    finish: Callable[[RunFolder], None] | None = None,
) -> RunFolder:
    """Put run folders into a new one; the old ones stay as they are.

    The union of their results: what two runs both have must be made from the same and be the same,
    captured frames, depth, masks and renders byte by byte, values up to rounding. The seconds of a
    render, a fitted scene and the seconds of live depth are those of the run that is named first.

    Args:
        out: run folder to make; whole or not at all.
        roots: at least one run folder.
        copy: copy files; otherwise they are linked where the file system can, so that nothing is
            stored twice.
        finish: what shall be done in the new run before it takes its place.

    Returns:
        The new run, which `ggvs_eval.pipelines.run.score.score` makes the table of.

    Raises:
        ProtocolError: other protocols, captures or ways to find depth; the message says what
            differs. Or `out` exists.
        ResultsError: no run folder; or two results of one task that differ, both of which are
            named.
    """
    runs = [RunFolder(root) for root in roots]
    if out.exists():
        raise ProtocolError(
            f"{out}: wanted a new folder to merge into, got an existing one; choose another"
        )
    _require_alike(runs)
    results: dict[Path, list[Path]] = {}  # place in a run -> the folders of the runs that have it
    for run in runs:
        for folder in _result_folders(run.root):
            results.setdefault(folder, []).append(run.root / folder)
    with atomic_folder(out) as temporary:
        for name, folders in results.items():
            of_fit = name.parts[0] == FITS  # what was rendered from it is compared
            join_results(
                folders[:1] if of_fit else folders,
                temporary / name,
                shutil.copy2 if copy else link_file,
            )
        for record in FILES:
            files = [run.root / record for run in runs if (run.root / record).is_file()]
            for file in files[:1]:
                _place(file, temporary / record, shutil.copy2)
            for duplicate in files[1:]:
                if not filecmp.cmp(files[0], duplicate, shallow=False):
                    raise _differ(files[0], duplicate, "they have different bytes")
        _write_records(runs, temporary)
        if finish is not None:
            try:
                finish(RunFolder(temporary))
            except GgvsError as error:
                raise type(error)(str(error).replace(str(temporary), str(out))) from None
    return RunFolder(out)


def _result_folders(root: Path) -> list[Path]:
    """Return the place of every result in a run; of imported renders, which are one, none inside.

    What is on a screen follows from times, and is measured again.
    """
    places = [file.parent.relative_to(root) for file in sorted(root.glob(f"**/{JOB_FILE}"))]
    hidden = {
        place
        for place in places
        if any(part.startswith(".") or part.endswith(ON_SCREEN) for part in place.parts)
    }
    merged_places = [
        place for place in places if place not in hidden and place.parts[0] not in NOT_MERGED
    ]
    return [
        place
        for place in merged_places
        if not any(above in merged_places for above in place.parents)
    ]


def join_results(folders: Sequence[Path], target: Path, place: Place) -> None:
    """Put the files of one result together, from all runs that have it."""
    first = folders[0]
    records = [read_record(folder) for folder in folders]
    for folder, record in zip(folders[1:], records[1:], strict=True):
        if reason := _difference(records[0], record):
            raise _differ(first, folder, reason)
    origins: dict[Path, Path] = {}
    for folder in folders:
        files = [(file.relative_to(folder), file) for file in _files_below(folder)]
        shared = [(name, file) for name, file in files if name in origins and name.name != JOB_FILE]
        wrong = [
            name for name, file in shared if not filecmp.cmp(origins[name], file, shallow=False)
        ]
        if wrong:
            raise _differ(
                first,
                folder,
                f"{len(wrong)} of {len(shared)} files have different bytes, first {wrong[0]}",
            )
        origins = dict(files) | origins
    for name, file in origins.items():
        _place(file, target / name, place)
    if len(folders) > 1:
        noted = {
            name: status for record in reversed(records) for name, status in record["files"].items()
        }
        (target / JOB_FILE).unlink()  # it may be a link
        write_json(target / JOB_FILE, records[0] | {"files": noted})


def _difference(first: Mapping[str, Any], second: Mapping[str, Any]) -> str:
    """Return why two results of one name are not the same; empty if they are."""
    if first.get("sha256") != second.get("sha256"):
        inputs, other_inputs = first.get("identity", {}), second.get("identity", {})
        changed = [
            name
            for name in dict.fromkeys([*inputs, *other_inputs])
            if inputs.get(name) != other_inputs.get(name)
        ]
        return f"they have other {', '.join(changed) or 'inputs'}"
    if not same_values(first.get("values"), second.get("values")):
        return "their values differ"
    return ""


def _differ(first: Path, second: Path, reason: str) -> ResultsError:
    return ResultsError(
        f"{first} and {second} differ: {reason}; keep one of them, or prepare once and copy truth/ "
        "and depth/ of that run to every machine before rendering"
    )


def _files_below(folder: Path) -> Iterator[Path]:
    for file in sorted(folder.rglob("*")):
        if file.is_file() and not any(
            part.startswith(".") for part in file.relative_to(folder).parts
        ):
            yield file


def _place(file: Path, destination: Path, place: Place) -> None:
    destination.parent.mkdir(parents=True, exist_ok=True)
    place(file, destination)


def _require_alike(runs: Sequence[RunFolder]) -> None:
    """Refuse runs that do not belong in one table."""
    if not runs:
        raise ResultsError("wanted run folders to merge, got none")
    first, *later_runs = runs
    identity = _identity(first)
    for run in later_runs:
        if differences := name_differences(identity, _identity(run)):
            raise ProtocolError(
                f"{first.root} and {run.root} are not runs of one protocol and capture: "
                f"{differences}; merge runs that differ in their methods or rendered views alone"
            )


def _identity(run: RunFolder) -> dict[str, Any]:
    """Return the properties that runs must share, by the words that a message uses."""
    record = run.capture_record()
    depth = read_json(run.depth_record) if run.depth_record.is_file() else {}
    return {
        "protocol": run.protocol().values(),
        "capture": {name: record.get(name) for name in SAME_OF_CAPTURE},
        "depth": {
            name: value
            for name, value in depth.items()
            if name not in ("stereo_weights", UNEXPLAINED)
        },
    }


def _write_records(runs: Sequence[RunFolder], folder: Path) -> None:
    first = runs[0]
    source_run = next((run for run in runs if run.capture_path().exists()), first)
    place = source_run.capture_path().resolve()
    place_record = {"absolute": str(place), "from_run": os.path.relpath(place, folder.resolve())}
    shutil.copy2(first.protocol_file, folder / first.protocol_file.name)
    write_json(folder / "capture.json", source_run.capture_record() | {"place": place_record})
    for record in ("depth_record", "live_depth_record"):
        files = [file for run in runs if (file := getattr(run, record)).is_file()]
        if files:
            shutil.copy2(files[0], folder / files[0].name)
    write_json(
        folder / "methods.json",
        {"labels": list(dict.fromkeys(label for run in runs for label in run.labels()))},
    )
    ledgers = [
        read_json(file)
        for run in runs
        if (file := run.root / JOBS_FOLDER / "render.json").is_file()
    ]
    if ledgers:
        jobs = {name: job for ledger in reversed(ledgers) for name, job in ledger["jobs"].items()}
        write_json(folder / JOBS_FOLDER / "render.json", {"jobs": jobs})
