"""The tables of a report: quality, consistency, each view by itself, time per stage."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import pandas as pd

from ggvs_eval.errors import ResultsError, did_you_mean
from ggvs_eval.reports.model.measured import (
    MeasuredRun,
    captured_values,
    reference_remarks,
    reference_rows,
    shared_references,
)
from ggvs_eval.reports.model.metric_note import MetricNote, note_groups
from ggvs_eval.reports.model.table import Cell, Column, Row, Table, join_tables, measured_cell, rank
from ggvs_eval.reports.tables.captions import main_captions
from ggvs_eval.reports.tables.certainty import certainty_captions
from ggvs_eval.reports.tables.community import community_rows, describe_published
from ggvs_eval.reports.tables.comparable_runs import why_not_beside
from ggvs_eval.reports.tables.published import paper_dataset, published_rows
from ggvs_eval.results import Results, label_of
from ggvs_eval.statistics.paired import Judgement, judge

PUBLISHED_GROUPS = ("quality", "consistency")
ALONG_PATH = "path"  # table whose reference row is the captured images


def main_tables(runs: Sequence[MeasuredRun], results: Results, columns: Sequence[str] = ()) -> tuple[Table, ...]:
    """Quality and consistency per dataset: means over frames, then views, then scenes.

    Args:
        runs: at least one, all under one protocol.
        columns: metrics that make a single table, in this order; all of them, in tables of their own, by default.

    Returns:
        Per dataset one table for each group of the metrics that the protocol asks for, in its order.

    Raises:
        ResultsError: a column that was not measured.
    """
    known = list(runs[0].metrics)
    if unknown := [name for name in columns if name not in known]:
        near = did_you_mean(unknown[0], known)
        raise ResultsError(f"columns: {', '.join(unknown)} was not measured; use some of {', '.join(known)}{near}")
    groups = note_groups([note for note in runs[0].metrics.values() if not columns or note.name in columns])
    summary = results.summary()
    tables = []
    for dataset in dict.fromkeys(str(name) for name in summary.index.get_level_values("dataset")):
        tables += [_main_table(dataset, notes, runs, summary, results) for notes in groups.values()]
    return join_tables(tables, columns) if columns else tuple(tables)


def _main_table(
    dataset: str, notes: tuple[MetricNote, ...], runs: Sequence[MeasuredRun], summary: pd.DataFrame, results: Results
) -> Table:
    key, title, metrics = notes[0].group, notes[0].group_title, tuple(note.name for note in notes)
    columns = tuple(metric_column(note) for note in notes)
    here = cast(pd.DataFrame, summary.xs(dataset, level="dataset"))
    references = shared_references(runs)
    captured = captured_values(references) if key == ALONG_PATH else {}
    own = frozenset().union(*(run.ours for run in runs))
    judgements = {
        note.name: judge(results, note.name, note.higher_is_better, dataset, captured=captured.get(note.name), own=own)
        for note in notes
        if note.name in here and here[note.name].notna().any()
    }
    rows = measured_rows(runs, here, metrics, notes, results, judgements)
    marked = [judgements[name].marked if name in judgements else () for name in metrics]
    published, remarks = _published(key, dataset, metrics, runs)
    grey = reference_rows(references, key, notes) + published
    names = {row.label: row.name for row in rows}
    means, *terms = main_captions(key, runs, results, names, metrics)
    marks, found = certainty_captions(judgements, names, results.set_aside)
    caption = " ".join([means, *marks])
    below = (*terms, *found, *reference_remarks(references, key, notes), *remarks)
    return Table(key, title, caption, columns, rank(columns, rows, marked) + grey, dataset, below, judgements)


def _published(key: str, dataset: str, metrics: Sequence[str], runs: Sequence[MeasuredRun]) -> tuple[tuple[Row, ...], list[str]]:
    """Published rows of a table on whose terms the runs are, and where they are from or why there are none."""
    protocol = runs[0].protocol
    scenes = [f"{run.scene}, a demo capture," if run.is_demo else run.scene for run in runs]
    rows = community_rows(protocol, scenes, metrics)
    remarks = describe_published(protocol, scenes) if rows or key == PUBLISHED_GROUPS[0] else []
    if key not in PUBLISHED_GROUPS or not paper_dataset(dataset):
        return rows, remarks
    if why := why_not_beside(paper_dataset(dataset), runs):
        return rows, [f"The paper's values are not shown here: {why}.", *remarks]
    return published_rows(key, dataset, metrics) + rows, remarks


def view_tables(run: MeasuredRun) -> tuple[Table, ...]:
    """One table per metric that has a value in each view: mean over frames, one column per view."""
    tables = []
    for metric in run.metrics:
        values = run.results.per_view(metric)
        if values.empty or not set(run.protocol.views.test) & set(values.columns):
            continue
        note, views = run.metrics[metric], run.protocol.views.test
        columns = tuple(Column(view, note.unit, note.higher_is_better) for view in views)
        rows = rank(columns, measured_rows([run], values, views, (note,) * len(views), run.results))
        unit = f", {note.unit}" if note.unit else ""
        caption = f"Mean over frames in each test view; {'higher' if note.higher_is_better else 'lower'} is better. "
        caption += "Shaded by the numbers alone; `ggvs-eval compare --views` tests single views."
        tables.append(Table(f"view-{metric}", f"{metric}{unit}", caption, columns, rows, run.scene))
    return tuple(tables)


def metric_column(note: MetricNote) -> Column:
    """Head of a column that holds one metric."""
    return Column(note.name, note.unit, note.higher_is_better, note.describe)


def row_labels(runs: Sequence[MeasuredRun], values: pd.DataFrame) -> list[str]:
    """Labels of the rows of a table: the runs' methods in their order, then what else has values."""
    measured = [label_of(method, variant) for method, variant in values.index]
    return list(dict.fromkeys([label for run in runs for label in run.labels] + measured))


def measured_rows(
    runs: Sequence[MeasuredRun],
    values: pd.DataFrame,
    keys: Sequence[str],
    notes: Sequence[MetricNote],
    results: Results,
    judgements: Mapping[str, Judgement] | None = None,
) -> tuple[Row, ...]:
    """A row per method, in the order of the runs' methods.

    Args:
        values: rows (method, variant).
        keys: columns of `values` to show.
        results: knows why a value may be absent.
        judgements: metric -> what is known of its numbers; None shows numbers alone.
    """
    by_label: dict[str, Any] = {label_of(*names): values.loc[names] for names in values.index}
    rows = []
    for label in row_labels(runs, values):
        names = next((run for run in runs if label in run.labels), runs[0])
        values_of = by_label.get(label, {})
        cells = [
            _cell(note, key, values_of.get(key), results, label, (judgements or {}).get(note.name))
            for key, note in zip(keys, notes, strict=True)
        ]
        rows.append(names.row(label, cells, results))
    return tuple(rows)


def _cell(note: MetricNote, key: str, value: float | None, results: Results, label: str, judgement: Judgement | None) -> Cell:
    is_partial = label in results.provenance.get("partial", {})
    absent = "partial renders" if is_partial else "no value in the results; run `ggvs-eval score` again"
    reason = results.why_absent(note.name, label, "" if key == note.name else key) or absent
    interval = judgement.interval(label) if judgement else None
    cell = measured_cell(None if value is None else float(value), reason, interval, note.decimals)
    return replace(cell, unranked=judgement.unranked.get(label, "")) if judgement else cell
