"""The tables of a report: quality, consistency, each view by itself, time per stage."""

from collections.abc import Sequence
from typing import cast

import pandas as pd

from ggvs_eval.reports.measured import MeasuredRun, MetricNote, label_of
from ggvs_eval.reports.published import published_rows
from ggvs_eval.reports.table import Cell, Column, Row, Table, measured_cell, rank
from ggvs_eval.results import Results

GROUPS = {
    "quality": ("Image quality", ("PSNR", "PSNR_cc", "SSIM", "LPIPS", "L1")),
    "consistency": ("Temporal and view consistency", ("TCC", "STED", "SDT", "SDV")),
}


def main_tables(runs: Sequence[MeasuredRun], results: Results) -> tuple[Table, ...]:
    """Quality and consistency per dataset: means over frames, then views, then scenes.

    Args:
        runs: at least one, all under one protocol.
        results: their results in one, see `ggvs_eval.results.merge_results`.

    Returns:
        Per dataset one table for each group of metrics that the protocol asks for; what belongs to no group comes last.
    """
    asked = runs[0].protocol.measurement.metrics
    grouped = {metric for _, metrics in GROUPS.values() for metric in metrics}
    groups = GROUPS | {"further": ("Further measures", tuple(metric for metric in asked if metric not in grouped))}
    summary = results.summary()
    tables = []
    for dataset in dict.fromkeys(str(name) for name in summary.index.get_level_values("dataset")):
        for key, (title, metrics) in groups.items():
            wanted = tuple(metric for metric in metrics if metric in asked)
            if wanted:
                tables.append(_main_table(key, title, dataset, wanted, runs, summary, results))
    return tuple(tables)


def _main_table(
    key: str,
    title: str,
    dataset: str,
    metrics: tuple[str, ...],
    runs: Sequence[MeasuredRun],
    summary: pd.DataFrame,
    results: Results,
) -> Table:
    columns = tuple(metric_column(runs[0].metrics[metric]) for metric in metrics)
    here = cast(pd.DataFrame, summary.xs(dataset, level="dataset"))
    rows = measured_rows(runs, here, metrics, metrics, results)
    published = published_rows(key, dataset, metrics) if key in GROUPS else ()
    protocol = runs[0].protocol
    frames, views = _count(protocol.frames.count, "frame"), _count(len(protocol.views.test), "view")
    caption = f"Mean over {frames}, then {views}, then scenes; K = {protocol.synthesis.k} source views."
    return Table(key, title, caption, columns, rank(columns, rows) + published, dataset)


def view_tables(run: MeasuredRun) -> tuple[Table, ...]:
    """One table per metric that has a value in each view: mean over frames, one column per view."""
    tables = []
    for metric in run.protocol.measurement.metrics:
        values = run.results.per_view(metric)
        if values.empty:
            continue
        note, views = run.metrics[metric], run.protocol.views.test
        columns = tuple(Column(view, note.unit, note.higher_is_better) for view in views)
        rows = rank(columns, measured_rows([run], values, views, (metric,) * len(views), run.results))
        unit = f", {note.unit}" if note.unit else ""
        caption = f"Mean over frames in each test view; {'higher' if note.higher_is_better else 'lower'} is better."
        tables.append(Table(f"view-{metric}", f"{metric}{unit}", caption, columns, rows, run.scene))
    return tuple(tables)


def metric_column(note: MetricNote) -> Column:
    """Head of a column that holds one metric."""
    return Column(note.name, note.unit, note.higher_is_better, note.describe)


def measured_rows(
    runs: Sequence[MeasuredRun], values: pd.DataFrame, keys: Sequence[str], metrics: Sequence[str], results: Results
) -> tuple[Row, ...]:
    """A row per method, in the order of the runs' methods.

    Args:
        runs: who was measured, under which names.
        values: rows (method, variant).
        keys: columns of `values` to show.
        metrics: metric of each of these columns.
        results: knows why a value may be absent.
    """
    by_label = {label_of(method, variant): values.loc[(method, variant)] for method, variant in values.index}
    rows = []
    for label in dict.fromkeys([label for run in runs for label in run.labels] + list(by_label)):
        names = next((run for run in runs if label in run.labels), runs[0])
        cells = [
            _cell(metric, by_label[label].get(key) if label in by_label else None, results)
            for key, metric in zip(keys, metrics, strict=True)
        ]
        rows.append(Row(names.name(label), tuple(cells), "ours" if label in names.ours else "measured"))
    return tuple(rows)


def _cell(metric: str, value: float | None, results: Results) -> Cell:
    reason = results.not_computed.get(metric, "no value in the results; run `ggvs-eval score` again")
    return measured_cell(metric, None if value is None else float(value), reason)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
