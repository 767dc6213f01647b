"""Runs of one protocol, which alone may share a table; a report holds one group of them or several."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import starmap
from pathlib import Path

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.digest import digest_files
from ggvs_eval.merged_results import merge_results
from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.figures.curves import Panel, curve_panels
from ggvs_eval.reports.figures.slices import Slices, all_slices
from ggvs_eval.reports.figures.sweep_figures import RatePanel, rate_panels
from ggvs_eval.reports.model.measured import MeasuredRun, name_scenes, read_run
from ggvs_eval.reports.model.table import Table
from ggvs_eval.reports.tables.costs import budget_tables, cost_tables, differences_table, price_tables
from ggvs_eval.reports.tables.error_budget import budget_table, decomposition_table
from ggvs_eval.reports.tables.report_tables import main_tables, view_tables
from ggvs_eval.reports.tables.timing import drift_table, stream_table, timing_table
from ggvs_eval.reports.tables.worst_frames import worst_frames_table
from ggvs_eval.results import Results

HASH_DIGITS = 8  # of a protocol's hash, where nothing else distinguishes two groups
RECORDS = (".json", ".parquet", ".toml")  # of a run; they name every frame that was measured by its content
SECTIONS_KEPT = 8


@dataclass(frozen=True)
class RunSection:
    """Everything that the page shows of one run.

    Attributes:
        view_tables: worst frames, place of the error, its variation, its drift over a long clip, and one per metric.
        costs: of every method, and what else differs; where some are fitted, seeds, time to equal quality, the best by budget.
        slices: along the path and over time.
        on_time: what reaches the screen, where the protocol has a stream.
        rate_panels: quality on the screen over pictures per second.
    """

    run: MeasuredRun
    view_tables: tuple[Table, ...]
    timing: Table
    costs: tuple[Table, ...]
    slices: Sequence[Slices]
    panels: tuple[Panel, ...]
    on_time: Table | None = None
    rate_panels: tuple[RatePanel, ...] = ()


@dataclass(frozen=True)
class RunGroup:
    """Runs of one protocol, with their tables and figures.

    Attributes:
        name: short, and no other group of the report has it.
        heading: the same for a reader of the page.
        results: of all runs in one.
        tables: quality, consistency and all other measurements, over all runs.
        price: of being online, where some method is fitted.
    """

    name: str
    heading: str
    sections: tuple[RunSection, ...]
    results: Results
    tables: tuple[Table, ...]
    price: tuple[Table, ...]

    @property
    def protocol(self) -> Protocol:
        """Under which all runs were measured."""
        return self.sections[0].run.protocol

    @property
    def scenes(self) -> str:
        """Names of the captured scenes."""
        return ", ".join(dict.fromkeys(section.run.scene for section in self.sections))

    @property
    def titles(self) -> str:
        """Titles of the captured scenes, as readers know them."""
        return ", ".join(dict.fromkeys(section.run.title for section in self.sections))

    @property
    def all_tables(self) -> tuple[Table, ...]:
        """The tables over all runs, then each run's own."""
        of_runs = (table for one in self.sections for table in (one.on_time, *one.view_tables, one.timing, *one.costs))
        return (*self.tables, *self.price, *(table for table in of_runs if table))


def read_groups(roots: Sequence[Path]) -> tuple[RunGroup, ...]:
    """Read scored runs and group them by the hash of their protocol, in the order in which they are given.

    Raises:
        ResultsError: no run, a run given twice, or a folder that is not a scored run.
        RenderError: frames are missing.
    """
    by_protocol = runs_by_protocol(roots, read_run)
    firsts = [runs[0] for runs in by_protocol]
    names = _name_groups(firsts, [run.scene for run in firsts])
    headings = _name_groups(firsts, [run.title for run in firsts])
    return tuple(starmap(_make_group, zip(names, headings, by_protocol, strict=True)))


def runs_by_protocol(roots: Sequence[Path], read: Callable[[Path], MeasuredRun]) -> list[list[MeasuredRun]]:
    """Read runs and sort them by the hash of their protocol, in the order in which they are given."""
    if not roots:
        raise ResultsError("wanted at least one run folder, got none; make one with `ggvs-eval run`")
    places = [Path(root).resolve() for root in roots]
    if len(set(places)) < len(places):
        twice = next(root for root, place in zip(roots, places, strict=True) if places.count(place) > 1)
        raise ResultsError(
            f"{twice}: wanted each run once, it is given {places.count(Path(twice).resolve())} times; name it once"
        )
    by_protocol: dict[str, list[MeasuredRun]] = {}
    for run in map(read, roots):
        by_protocol.setdefault(run.protocol.sha256, []).append(run)
    return [name_scenes(runs) for runs in by_protocol.values()]


def _make_group(name: str, heading: str, runs: Sequence[MeasuredRun]) -> RunGroup:
    results = merge_results([run.results for run in runs])
    tables, price = main_tables(runs, results), price_tables(runs, results)
    return RunGroup(name, heading, tuple(map(_make_section, runs)), results, tables, price)


def _make_section(run: MeasuredRun) -> RunSection:
    records = [file for file in run.folder.root.iterdir() if file.suffix in RECORDS]
    return _read_section(run.folder.root, digest_files(sorted(records)), run.scene)


@lru_cache(maxsize=SECTIONS_KEPT)
def _read_section(root: Path, scored: str, scene: str) -> RunSection:
    """The section of a run with these results: a page that grows with every run reads the frames of the earlier ones once."""
    run = read_run(root).called(scene)
    apart = (worst_frames_table(run), budget_table(run), decomposition_table(run), drift_table(run))
    taken_apart = tuple(table for table in apart if table)
    costs = tuple(table for table in (*cost_tables(run), *budget_tables(run), differences_table(run)) if table)
    tables = taken_apart + view_tables(run), timing_table(run), costs
    return RunSection(run, *tables, all_slices(run), curve_panels(run), stream_table(run), rate_panels([run]))


def _name_groups(firsts: Sequence[MeasuredRun], scenes: Sequence[str]) -> list[str]:
    """Name the groups so that they differ: scene, protocol and K, with the protocol's hash where these are the same."""
    terms = [(scene, run.protocol.name, run.sources_text) for run, scene in zip(firsts, scenes, strict=True)]
    names = [", ".join(filter(None, each)) for each in terms]
    hashes = [run.protocol.sha256[:HASH_DIGITS] for run in firsts]
    return [f"{name}, {digest}" if names.count(name) > 1 else name for name, digest in zip(names, hashes, strict=True)]
