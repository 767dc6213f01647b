"""Runs of one protocol, which alone may share a table.

A report holds one group of them or several.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import count
from pathlib import Path

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.digest import digest_files
from ggvs_eval.merged_results import merge_results
from ggvs_eval.reports.model.measured import MeasuredRun, name_scenes, read_run
from ggvs_eval.reports.section import RUNS_KEPT, RunGroup
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.verdict import evaluate_verdict

HASH_DIGITS = 8  # of a protocol's hash, where nothing else distinguishes two groups
# of a run; they name every frame that was measured by its content
RECORDS = (".json", ".parquet", ".toml")


def read_groups(
    roots: Sequence[Path], read: Callable[[Path], MeasuredRun] | None = None
) -> tuple[RunGroup, ...]:
    """Read scored runs and group them by the hash of their protocol, in the order in which they are
    given.

    Args:
        read: reads a run; by default with a look for its frames, once while it is unchanged.

    Raises:
        ResultsError: no run, a run given twice, or a folder that is not a scored run.
        RenderError: frames are missing.
    """
    by_protocol = runs_by_protocol(roots, read or _read)
    firsts = [runs[0] for runs in by_protocol]
    names = _name_groups(firsts, [run.scene for run in firsts])
    headings = _name_groups(firsts, [run.title for run in firsts])
    numbers = count()
    groups = []
    for at, (name, heading, runs) in enumerate(zip(names, headings, by_protocol, strict=True)):
        results = merge_results([run.results for run in runs])
        tables = main_tables(runs, results)
        group = RunGroup(
            id=f"group{at}",
            name=name,
            heading=heading,
            runs={f"run{next(numbers)}": run for run in runs},
            results=results,
            tables=tables,
            verdict=evaluate_verdict(runs, results, tables),
        )
        groups.append(group)
    return tuple(groups)


def _read(root: Path) -> MeasuredRun:
    """Read a run, or return it as it was read.

    Sections keep by it what they have read of its frames.
    """
    records = [file for file in Path(root).glob("*") if file.suffix in RECORDS]
    return _read_records(Path(root), digest_files(sorted(records)))


@lru_cache(maxsize=RUNS_KEPT)
def _read_records(root: Path, scored: str) -> MeasuredRun:
    return read_run(root)


def runs_by_protocol(
    roots: Sequence[Path], read: Callable[[Path], MeasuredRun]
) -> list[list[MeasuredRun]]:
    """Read runs and sort them by the hash of their protocol, in the order in which they are
    given.
    """
    if not roots:
        raise ResultsError(
            "wanted at least one run folder, got none; make one with `ggvs-eval run`"
        )
    places = [Path(root).resolve() for root in roots]
    if len(set(places)) < len(places):
        twice = next(
            root for root, place in zip(roots, places, strict=True) if places.count(place) > 1
        )
        raise ResultsError(
            f"{twice}: wanted each run once, it is given {places.count(Path(twice).resolve())} "
            f"times; name it once"
        )
    by_protocol: dict[str, list[MeasuredRun]] = {}
    for run in map(read, roots):
        by_protocol.setdefault(run.protocol.sha256, []).append(run)
    return [name_scenes(runs) for runs in by_protocol.values()]


def _name_groups(firsts: Sequence[MeasuredRun], scenes: Sequence[str]) -> list[str]:
    """Name the groups so that they differ: scene, protocol and K, with the protocol's hash where
    these are the same.
    """
    terms = [
        (scene, run.protocol.name, run.sources_text)
        for run, scene in zip(firsts, scenes, strict=True)
    ]
    names = [", ".join(filter(None, parts)) for parts in terms]
    hashes = [run.protocol.sha256[:HASH_DIGITS] for run in firsts]
    return [
        f"{name}, {digest}" if names.count(name) > 1 else name
        for name, digest in zip(names, hashes, strict=True)
    ]
