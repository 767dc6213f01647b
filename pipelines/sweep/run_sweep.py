"""Run a sweep: the whole evaluation once per capture and variant of the protocol, and one table of all of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from ggvs_eval.capture import Capture
from ggvs_eval.errors import ProtocolError
from ggvs_eval.files.atomic import atomic_file, locked
from ggvs_eval.jobs.engine import Engine, Workers, as_engine
from ggvs_eval.jobs.ledger import Failure
from ggvs_eval.jobs.processes import kept_workers
from ggvs_eval.jobs.shard import WHOLE, Shard
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.methods.registry import split_label
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.run.coverage import read_import
from ggvs_eval.pipelines.run.run_plan import RunPlan, plan_run
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.pipelines.sweep.cells import Captures, Cell, share_of, sweep_cells
from ggvs_eval.pipelines.sweep.stages import attempt, import_cells, plan_cells, prepare_cells, render_cells, score_cells
from ggvs_eval.protocol import Protocol
from ggvs_eval.results import Results
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json
from ggvs_eval.sweep import Sweep, SweepRow

LINE_NAMES = ("capture", "variant", "method")  # of a line of the table, as far as it needs them

ShowPlans = Callable[[Sequence[RunPlan]], None]


@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep.

    Attributes:
        table: one line per variant and row: mean of each metric, and seconds per frame; of several captures per capture too.
        not_computed: title of a row -> reason.
        runs: the run folder of each variant, ``capture/variant`` where there are several captures.
        failures: what failed; its rows are not in the table, and the same call tries it again.
    """

    table: pd.DataFrame
    not_computed: dict[str, str]
    runs: dict[str, Path]
    failures: tuple[Failure, ...] = ()


@kept_workers()
def run_sweeps(
    root: Path,
    captures: Captures,
    sweep: Sweep,
    workers: Workers,
    depth: DepthRunOptions | None = None,
    networks: NetworkOptions = AS_SHIPPED,
    shard: Shard = WHOLE,
    show_plans: ShowPlans = lambda _: None,
) -> SweepResult:
    """Run a sweep on several captures, each in a folder of its own, and give their means beside the single tables.

    Args:
        root: folder of the sweeps.
        captures: name of the capture's folder in it -> the capture, and what its variants start from.
        sweep: rows and variants.
        workers: where jobs run.
        depth: how depth is found, see `DepthRunOptions`.
        networks: with which weights and where networks compute.
        shard: which views are rendered and scored; only the whole has a table.
        show_plans: is called with the plans of the runs before anything is written.

    Returns:
        The table's first level is the capture; ``mean`` is the mean over the captures, of lines that all of them have.

    Raises:
        ProtocolError: captures whose protocols measure differently, so that a mean says nothing; or no row can be computed.
    """
    kinds = {protocol.measurement for _, protocol in captures.values()}
    if len(kinds) != 1:
        raise ProtocolError(f"{root}: wanted captures that are measured alike, got {len(kinds)} kinds; name one with --protocol")
    result = _run(root, captures, sweep, as_engine(workers), depth, networks, shard, show_plans)
    if result.table.empty:
        return result
    lines = result.table.groupby(level=["variant", "method"], sort=False)
    means = lines.mean()[lines.size() == len(captures)]
    table = pd.concat([result.table, pd.concat({"mean": means}, names=["capture"])])
    _write_table(table, root)
    return replace(result, table=table)


@kept_workers()
def run_sweep(
    root: Path,
    capture: Capture,
    sweep: Sweep,
    protocol: Protocol,
    workers: Workers,
    depth: DepthRunOptions | None = None,
    networks: NetworkOptions = AS_SHIPPED,
    shard: Shard = WHOLE,
    show_plans: ShowPlans = lambda _: None,
) -> SweepResult:
    """Evaluate every row under every variant; what exists is not computed again, and what fails does not stop the rest.

    Frames and depth are shared between the variants, so that K = 2 finds what K = 6 has computed.

    Args:
        root: folder of the sweep; each variant is a run folder in it.
        capture: what to evaluate on.
        sweep: rows and variants.
        protocol: what the variants start from.
        workers: where jobs run.
        depth: how depth is found, see `DepthRunOptions`.
        networks: with which weights and where networks compute.
        shard: which views are rendered and scored; only the whole has a table.
        show_plans: is called with the plans of the runs before anything is written.

    Raises:
        ProtocolError: no row can be computed.
    """
    result = _run(root, {"": (capture, protocol)}, sweep, as_engine(workers), depth, networks, shard, show_plans)
    if result.table.empty:
        return result
    table = result.table.droplevel("capture")
    _write_table(table, root)
    return replace(result, table=table)


def _run(
    root: Path,
    captures: Captures,
    sweep: Sweep,
    engine: Engine,
    depth: DepthRunOptions | None,
    networks: NetworkOptions,
    shard: Shard,
    show_plans: ShowPlans,
) -> SweepResult:
    """Every stage for all runs, then a line per run and row of which nothing is missing."""
    cells, absent = sweep_cells(root, captures, sweep, networks)
    runs = {cell.name: cell.run.root for cell in cells}
    taken, share = _shard_cells(cells, shard)
    plans, failures = plan_cells(taken, depth, networks, share)
    show_plans(list(plans.values()))
    ready, unprepared = prepare_cells(taken, plans, engine)
    failures += unprepared
    imported, refused = import_cells(taken, ready, engine)
    failures += refused
    if shard.prepares_only or not taken:
        return SweepResult(pd.DataFrame(), absent, runs, tuple(failures))
    whole, unrendered = render_cells(taken, ready, engine, networks, share, imported)
    good, unscored = score_cells(taken, whole, engine, share, networks.device)
    failures += [*unrendered, *unscored]
    parts = []
    for cell in cells if shard.is_whole else ():
        if cell.name in good:
            lines, why_not = attempt(
                f"table of {cell.name}", partial(_score_lines, cell, whole[cell.name], engine, networks.device)
            )
            failures += why_not
            parts += [] if lines is None else [lines]
    return SweepResult(pd.concat(parts) if parts else pd.DataFrame(), absent, runs, tuple(failures))


def plan_runs(
    root: Path,
    captures: Captures,
    sweep: Sweep,
    depth: DepthRunOptions | None,
    networks: NetworkOptions,
    shard: Shard = WHOLE,
) -> list[RunPlan]:
    """The runs of a sweep that a shard works on, as they will be made; arguments as of `run_sweeps`.

    Raises:
        GgvsError: a run that cannot be made.
    """
    cells, _ = sweep_cells(root, captures if len(captures) > 1 else {"": next(iter(captures.values()))}, sweep, networks)
    taken, share = _shard_cells(cells, shard)
    return [plan_run(cell.request(depth, networks, share.get(cell.name))) for cell in taken]


def _shard_cells(cells: list[Cell], shard: Shard) -> tuple[list[Cell], dict[str, set[str]]]:
    """The runs that a shard takes part in, and its views of each; one that only prepares has none."""
    if shard.prepares_only:
        return cells, {}
    share = share_of(cells, shard)
    return [cell for cell in cells if cell.name in share], share


def _write_table(table: pd.DataFrame, root: Path) -> None:
    """Write the table whole or not at all; lines of other sweeps into the same folder stay."""
    file, lines = root / "sweep.csv", table.reset_index()
    with locked(root):
        if file.is_file():
            lines = _with_lines(pd.read_csv(file, dtype=str), lines)  # as text, so that no digit changes
        with atomic_file(file) as temporary:
            lines.to_csv(temporary, index=False)


def _with_lines(before: pd.DataFrame, lines: pd.DataFrame) -> pd.DataFrame:
    """A table with more lines, which take the places of those of the same name.

    Reading:
        Where only one of the two names captures, the other's lines have an empty one: their runs lie beside those folders.
    """
    names = [name for name in LINE_NAMES if name in before or name in lines]
    named = (
        part.assign(**{name: part.get(name, "") for name in names}).fillna(dict.fromkeys(names, "")) for part in (before, lines)
    )
    old, new = (part.set_index(names) for part in named)
    order = [*old.index, *(name for name in new.index if name not in old.index)]
    return pd.concat([old[~old.index.isin(new.index)], new]).loc[order].reset_index()


def _score_lines(cell: Cell, labels: Sequence[str], engine: Engine, device: str) -> pd.DataFrame:
    """Collect what is measured of one run into its results, and its rows of the sweep's table."""
    results = score(cell.run, engine, without=[label for label in cell.labels if label not in labels], device=device)
    return _lines(cell, results, [row for row in cell.rows if row.label in labels])


def _lines(cell: Cell, results: Results, rows: list[SweepRow]) -> pd.DataFrame:
    """The rows of one run by their titles, with the time of a frame."""
    summary = results.summary().droplevel("dataset")
    lines = pd.DataFrame([summary.loc[split_label(row.label)] for row in rows], index=[row.title for row in rows])
    lines["s/frame"] = [_seconds_per_frame(cell.run, row.label) for row in rows]
    lines.index = pd.MultiIndex.from_product([[cell.folder], [cell.variant], lines.index], names=LINE_NAMES)
    return lines


def _seconds_per_frame(run: RunFolder, label: str) -> float:
    """Median over all frames of all views; nothing is known of frames that others rendered."""
    if read_import(run, label) is not None:
        return float("nan")
    records = [read_json(run.renders(label, view) / JOB_FILE)["seconds"] for view in run.protocol().views.test]
    return float(np.median([sum(stages) for record in records for stages in zip(*record.values(), strict=True)]))
