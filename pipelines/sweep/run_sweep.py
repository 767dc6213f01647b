"""Run a sweep: the whole evaluation once per capture and variant of the protocol, and one table of
all of them.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from ggvs_eval.coverage import read_import
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import Failure, ProtocolError
from ggvs_eval.files.atomic import atomic_file, locked
from ggvs_eval.jobs.engine import Workers, as_engine
from ggvs_eval.jobs.processes import kept_workers
from ggvs_eval.jobs.shard import WHOLE, Shard
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.run.evaluate import Stages, attempt, measure_runs
from ggvs_eval.pipelines.run.prepare import drop_found_depth
from ggvs_eval.pipelines.run.run_plan import RunPlan, plan_run
from ggvs_eval.pipelines.run.score import Scores
from ggvs_eval.pipelines.sweep.cells import Captures, Cell, shard_cells, sweep_cells
from ggvs_eval.results import reduced_mark, split_label
from ggvs_eval.run_folder import JOB_FILE, ON_SCREEN, SCREEN_TITLE, RunFolder, read_json
from ggvs_eval.sweep import Sweep

LINE_NAMES = ("capture", "variant", "method")  # of a line of the table, as far as it needs them


@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep.

    Attributes:
        table: one line per variant and row: mean of each metric, and seconds per frame; of several
            captures per capture too.
        not_computed: title of a row -> reason.
        runs: the run folder of each variant, ``capture/variant`` where there are several captures.
        failures: what failed; its rows are not in the table, and the same call tries it again.
    """

    table: pd.DataFrame
    not_computed: dict[str, str]
    runs: dict[str, Path]
    failures: tuple[Failure, ...] = ()

    def with_lines(self, lines: pd.DataFrame) -> pd.DataFrame:
        """Return the table with further lines of its captures, each below those of its capture, and
        their means.
        """
        if "capture" not in self.table.index.names:
            return pd.concat([self.table, lines.droplevel("capture")])
        together = pd.concat([self.table.drop("mean", level="capture", errors="ignore"), lines])
        names = together.index.unique("capture")
        by_capture = [
            together[together.index.get_level_values("capture") == name] for name in names
        ]
        return _with_means(pd.concat(by_capture), len({run.partition("/")[0] for run in self.runs}))


@dataclass(frozen=True)
class SweepPlan:
    """A sweep as it will be made.

    Attributes:
        root: folder of the sweep; each variant is a run folder in it.
        absent: title of a row that cannot be computed -> reason.
        shard: which units are rendered and scored; only the whole has a table.
        plans: of the runs that the shard works on.
        failures: why others of these cannot be made.
    """

    root: Path
    cells: tuple[Cell, ...]
    absent: dict[str, str]
    shard: Shard
    plans: tuple[RunPlan, ...]
    failures: tuple[Failure, ...]


def plan_cells(
    root: Path,
    captures: Captures,
    sweep: Sweep,
    depth: DepthRunOptions | None = None,
    networks: NetworkOptions = AS_SHIPPED,
    shard: Shard = WHOLE,
    shared: Path | None = None,
) -> SweepPlan:
    """Plan every row under every variant; nothing is written.

    Args:
        captures: name of the capture's folder in it -> the capture, and what its variants start
            from; a single one needs no name.
        depth: how depth is found, see `DepthRunOptions`.
        shard: which units are rendered and scored.
        shared: folder whose frames and depth all runs use; by default those of one capture have
            them in common, and fits, so that K = 2 finds what K = 6 has computed.
    """
    kinds = {protocol.measurement for _, protocol in captures.values()}
    if len(kinds) != 1:
        raise ProtocolError(
            f"{root}: wanted captures with one protocol, got {len(kinds)}; choose one with "
            f"--protocol"
        )
    cells, absent = sweep_cells(root, captures, sweep, depth, networks, shared)
    failures: list[Failure] = []
    tried = [
        attempt(f"prepare {cell.name}", partial(plan_run, cell.request), failures)
        for cell in shard_cells(cells, shard)
    ]
    return SweepPlan(
        root=root,
        cells=tuple(cells),
        absent=absent,
        shard=shard,
        plans=tuple(plan for plan in tried if plan is not None),
        failures=tuple(failures),
    )


@kept_workers()
def run_sweep(planned: SweepPlan, workers: Workers) -> SweepResult:
    """Evaluate a plan; existing results are not computed again, and a failure does not stop the
    rest.

    Of several captures the means are shown with the single tables.
    """
    stages = Stages(planned.root, as_engine(workers), goes_on=True, failures=[*planned.failures])
    scores_by_name = {plan.name: scores for plan, scores in measure_runs(planned.plans, stages)}
    if planned.shard.is_whole and not stages.failures:
        drop_found_depth(planned.plans)
    parts = []
    for cell in planned.cells if planned.shard.is_whole else ():
        if cell.name in scores_by_name:
            parts.append(
                stages.attempt(
                    f"table of {cell.name}", partial(_lines, cell, scores_by_name[cell.name])
                )
            )
    parts = [part for part in parts if part is not None]
    n_captures = len({cell.folder for cell in planned.cells})
    table = _with_means(pd.concat(parts), n_captures) if parts else pd.DataFrame()
    if parts:
        _write_table(table, planned.root)
    runs = {cell.name: cell.request.root for cell in planned.cells}
    return SweepResult(
        table=table, not_computed=planned.absent, runs=runs, failures=tuple(stages.failures)
    )


def _with_means(table: pd.DataFrame, n_captures: int) -> pd.DataFrame:
    """Return the table with the means over all captures, of lines that each of them has.

    Of one capture, without its name.
    """
    if n_captures == 1:
        return table.droplevel("capture")
    lines = table.groupby(level=["variant", "method"], sort=False)
    means = lines.mean()[lines.size() == n_captures]
    return pd.concat([table, pd.concat({"mean": means}, names=["capture"])])


def _write_table(table: pd.DataFrame, root: Path) -> None:
    """Write the table whole or not at all; lines of other sweeps into the same folder stay."""
    file, lines = root / "sweep.csv", table.reset_index()
    with locked(root):
        if file.is_file():
            # as text, so that no digit changes
            lines = _with_lines(pd.read_csv(file, dtype=str), lines)
        with atomic_file(file) as temporary:
            lines.to_csv(temporary, index=False)


def _with_lines(before: pd.DataFrame, lines: pd.DataFrame) -> pd.DataFrame:
    """Return a table with more lines, which take the places of those of the same name.

    Reading:
        Where only one of the two names captures, the other's lines have an empty one: their runs
        are next to those folders.
    """
    names = [name for name in LINE_NAMES if name in before or name in lines]
    named = (
        part.assign(**{name: part.get(name, "") for name in names}).fillna(dict.fromkeys(names, ""))
        for part in (before, lines)
    )
    old, new = (part.set_index(names) for part in named)
    order = [*old.index, *(name for name in new.index if name not in old.index)]
    return pd.concat([old[~old.index.isin(new.index)], new]).loc[order].reset_index()


def _lines(cell: Cell, scores: Scores) -> pd.DataFrame:
    """Return the rows of one run by their titles, with the time of a frame.

    What was measured becomes its results.
    """
    summary, rows = (
        scores.collect().summary().droplevel("dataset"),
        [row for row in cell.rows if row.label in scores.labels],
    )
    names = cell.run.shown_names
    marks = [(row.title, reduced_mark(names.get(row.label, ""))) for row in rows]
    titles = [title if mark in title else f"{title}{mark}" for title, mark in marks]
    labels = [row.label for row in rows]
    screens = [at for at, label in enumerate(labels) if f"{label}{ON_SCREEN}" in scores.labels]
    titles += [f"{titles[at]}{SCREEN_TITLE}" for at in screens]
    labels += [f"{labels[at]}{ON_SCREEN}" for at in screens]
    lines = pd.DataFrame([summary.loc[split_label(label)] for label in labels], index=titles)
    lines["s/frame"] = [_seconds_per_frame(cell.run, label) for label in labels]
    lines.index = pd.MultiIndex.from_product(
        [[cell.folder], [cell.variant], lines.index], names=LINE_NAMES
    )
    return lines


def _seconds_per_frame(run: RunFolder, label: str) -> float:
    """Return the median over all frames of all views.

    Nothing is known of frames that others rendered.
    """
    if label.endswith(ON_SCREEN) or read_import(run, label) is not None:
        return float("nan")
    records = [
        read_json(run.renders(label, view) / JOB_FILE)["seconds"]
        for view in run.protocol().views.test
    ]
    seconds = [sum(stages) for record in records for stages in zip(*record.values(), strict=True)]
    return float(np.median(seconds)) if seconds else float("nan")
