"""The tables of a report: quality, consistency, each view alone, time per stage.

Captions of the main tables say the extent of each mean, its images, and values that do not compare.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import pandas as pd

from ggvs_eval import built_in
from ggvs_eval.errors import ResultsError, did_you_mean
from ggvs_eval.geometry.source_views import CHOSEN_AS
from ggvs_eval.merged_results import BETWEEN
from ggvs_eval.plugins import Registry
from ggvs_eval.progress import counted
from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.model.measured import (
    MeasuredRun,
    MetricNote,
    limit_by_cameras,
    note_groups,
    reference_remarks,
    reference_rows,
    shared_references,
)
from ggvs_eval.reports.model.table import Cell, Column, Row, Table, join_tables, measured_cell, rank
from ggvs_eval.reports.tables.verdict import certainty_captions, judge_runs
from ggvs_eval.results import Results, label_of, without_labels
from ggvs_eval.statistics.paired import Judgement, Standings

OWN_PACKAGE = "ggvs-eval"  # what its version changes is measured again
OWN_TRUTH_MEANS = (
    "Own truth: measured against the images included with the renders, not against a capture; "
    "their cropping and compression are unknown, and values of other data or other references are "
    "not comparable."
)
INTERCHANGE = (
    "A test view is excluded from its own rendering only and can be a source of others; "
    "set `views.sources` to forbid it."
)
Published = Callable[
    [str, str, Sequence[str], Sequence[MeasuredRun]], tuple[Sequence[Row], Sequence[str]]
]
# Of the key, data set, metrics and runs of a table: grey rows, and words on their source or why
# there are none.
PUBLISHED_VALUES: Registry[Published] = Registry("published values", built_in.PUBLISHED_VALUES)


def main_tables(
    runs: Sequence[MeasuredRun],
    results: Results,
    columns: Sequence[str] = (),
    with_grey: bool = True,
    standings: Mapping[str, Standings] | None = None,
) -> tuple[Table, ...]:
    """Return the quality and consistency per dataset: means over frames, then views, then scenes.

    Args:
        runs: at least one, all under one protocol.
        columns: metrics that make a single table, in this order; by default all of them, in
            separate tables.
        with_grey: also with rows that belong to no method, and published ones.
        standings: data set -> judgements, where they are known already.

    Returns:
        Per dataset one table for each group of the metrics that the protocol asks for, in its
        order.

    Raises:
        ResultsError: a column that was not measured.
    """
    measured_names = list(runs[0].metrics)
    if unknown := [name for name in columns if name not in measured_names]:
        near = did_you_mean(unknown[0], measured_names)
        raise ResultsError(
            f"columns: {', '.join(unknown)} was not measured; use some of "
            f"{', '.join(measured_names)}{near}"
        )
    groups = note_groups(
        [note for note in runs[0].metrics.values() if not columns or note.name in columns]
    )
    summary, standings = results.summary(), standings or judge_runs(runs, results)
    tables = []
    for dataset in dict.fromkeys(str(name) for name in summary.index.get_level_values("dataset")):
        tables += [
            _main_table(standings[dataset], notes, runs, summary, with_grey)
            for notes in groups.values()
        ]
    return join_tables(tables, columns) if columns else tuple(tables)


def _main_table(
    standings: Standings,
    notes: tuple[MetricNote, ...],
    runs: Sequence[MeasuredRun],
    summary: pd.DataFrame,
    with_grey: bool,
) -> Table:
    results, dataset = standings.results, standings.dataset
    key, title, metrics = notes[0].group, notes[0].group_title, tuple(note.name for note in notes)
    columns = tuple(metric_column(note) for note in notes)
    means_here = cast(pd.DataFrame, summary.xs(dataset, level="dataset"))
    references = shared_references(runs) if with_grey else ()
    judgements = {
        name: standings.judgements[name] for name in metrics if name in standings.judgements
    }
    rows = measured_rows(runs, means_here, metrics, notes, results, judgements)
    marked = [judgements[name].marked if name in judgements else () for name in metrics]
    grey, remarks = [*reference_rows(references, key, notes)], list[str]()
    for beside in PUBLISHED_VALUES.built_in().values() if with_grey else ():
        published, words = beside(key, dataset, metrics, runs)
        grey += published
        remarks += words
    names = {row.label: row.name for row in rows}
    means, *terms = main_captions(key, runs, results, names, metrics)
    marks, uncertainties = certainty_captions(judgements, names, results.set_aside)
    caption = " ".join(filter(None, [limit_by_cameras(runs), means, *marks]))
    below = (*terms, *uncertainties, *reference_remarks(references, key, notes), *remarks)
    return Table(
        key=key,
        title=title,
        caption=caption,
        columns=columns,
        rows=(*rank(columns, rows, marked), *grey),
        dataset=dataset,
        notes=below,
        judgements=judgements,
    )


def view_tables(run: MeasuredRun) -> tuple[Table, ...]:
    """Return one table per metric that has a value in each view: mean over frames, one column per
    view.
    """
    tables = []
    for metric in run.metrics:
        values = run.results.per_view(metric)
        if values.empty or not set(run.protocol.views.test) & set(values.columns):
            continue
        note, views = run.metrics[metric], run.protocol.views.test
        columns = tuple(Column(view, note.unit, note.higher_is_better) for view in views)
        rows = rank(columns, measured_rows([run], values, views, (note,) * len(views), run.results))
        unit = f", {note.unit}" if note.unit else ""
        caption = (
            f"Mean over frames in each test view; {'higher' if note.higher_is_better else 'lower'} "
            "is better. "
        )
        caption += "Shading shows the numbers only; `ggvs-eval compare --views` tests single views."
        tables.append(
            Table(
                key=f"view-{metric}",
                title=f"{metric}{unit}",
                caption=caption,
                columns=columns,
                rows=rows,
                dataset=run.scene,
            )
        )
    return tuple(tables)


def metric_column(note: MetricNote) -> Column:
    """Return the head of a column that holds one metric."""
    return Column(
        name=note.name,
        unit=note.unit,
        higher_is_better=note.higher_is_better,
        describe=note.describe,
    )


def row_labels(runs: Sequence[MeasuredRun], values: pd.DataFrame) -> list[str]:
    """Return the labels of the rows of a table: the runs' methods in their order, then what else
    has values.
    """
    labels = [label_of(method, variant) for method, variant in values.index]
    return list(dict.fromkeys([label for run in runs for label in run.labels] + labels))


def measured_rows(
    runs: Sequence[MeasuredRun],
    values: pd.DataFrame,
    keys: Sequence[str],
    notes: Sequence[MetricNote],
    results: Results,
    judgements: Mapping[str, Judgement] | None = None,
) -> tuple[Row, ...]:
    """Return a row per method, in the order of the runs' methods.

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


def _cell(
    note: MetricNote,
    key: str,
    value: float | None,
    results: Results,
    label: str,
    judgement: Judgement | None,
) -> Cell:
    is_partial = label in results.partial
    absent = (
        "partial renders" if is_partial else "no value in the results; run `ggvs-eval score` again"
    )
    reason = results.why_absent(note.name, label, "" if key == note.name else key) or absent
    interval = judgement.interval(label) if judgement else None
    cell = measured_cell(None if value is None else float(value), reason, interval, note.decimals)
    return replace(cell, unranked=judgement.unranked.get(label, "")) if judgement else cell


def main_captions(
    key: str,
    runs: Sequence[MeasuredRun],
    results: Results,
    names: Mapping[str, str],
    metrics: Sequence[str],
) -> list[str]:
    """Sentences on the basis of the numbers of a table.

    Args:
        names: label of each row -> name to show.
    """
    protocol = runs[0].protocol
    if key == "path":
        means = "Over the whole camera path, at one instant"
    else:
        frames, views = (
            counted(protocol.frames.count, "frame"),
            counted(len(protocol.views.test), "view"),
        )
        means = f"Mean over {frames}, then {views}, then scenes"
    sources = _sources(runs, names)
    partial = results.partial
    titles = {label: title for run in runs for label, title in run.names.items()}
    marks = [
        f"{titles.get(label, label)} is {mark}; it is not ranked."
        for label, mark in partial.items()
    ]
    marks += results.fault_lines(names)
    ranked = without_labels(results, partial)
    lacking = [*_fewer_frames(ranked, metrics, protocol), *_fewer_views(ranked, metrics, names)]
    marks += [OWN_TRUTH_MEANS] if any(run.has_own_truth for run in runs) else []
    marks += [
        f"Truth decoded {decoding}."
        for decoding in {run.capture.get("truth_decoding", "") for run in runs}
        if decoding
    ]
    test, stated = {*protocol.views.test}, {*protocol.views.sources}
    # a test view is a source of another one
    may_interchange = len(test) > 1 and (not stated or not stated.isdisjoint(test))
    shared = [INTERCHANGE] if sources and may_interchange else []
    cameras = [
        f"Cameras of {run.scene}: {run.calibration.describe()}." for run in runs if run.calibration
    ]
    return [
        f"{'; '.join(filter(None, (means, sources)))}.",
        *cameras,
        *shared,
        *lacking,
        *marks,
        *_versions(results),
    ]


def _sources(runs: Sequence[MeasuredRun], names: Mapping[str, str]) -> str:
    """Return the number of source views of those methods of which it is known.

    Empty if it is of none.
    """
    informed = set().union(*(run.from_sources for run in runs))
    exempt_names = [name for label, name in names.items() if label not in informed]
    if len(exempt_names) == len(names):
        return ""
    synthesis = runs[0].protocol.synthesis
    exempt = f", except for {', '.join(exempt_names)}" if exempt_names else ""
    rule = "" if synthesis.sources == "nearest" else f", {CHOSEN_AS[synthesis.sources]}"
    return f"K = {synthesis.k} source views{rule}{exempt}"


def _fewer_views(results: Results, metrics: Sequence[str], names: Mapping[str, str]) -> list[str]:
    """State the views or scenes that a mean lacks.

    A method without any value has a note in its cell.
    """
    present = set(zip(results.table["metric"], results.row_labels, strict=True))
    labels = {label for _, label in present}
    several = len(results.scenes) > 1
    lacking: dict[tuple[str, str, str], list[str]] = {}
    for absence in results.absences:
        if absence.metric in metrics and (absence.metric, absence.label) in present:
            place = " of ".join(
                filter(None, (absence.view, absence.scene if several or not absence.view else ""))
            )
            lacking.setdefault((absence.metric, place, absence.reason), []).append(absence.label)
    return [
        f"{metric}{'' if labels == set(affected) else ' of ' + _listed(affected, names)} is a mean "
        f"without {place} ({reason})."
        for (metric, place, reason), affected in lacking.items()
    ]


def _listed(labels: Sequence[str], names: Mapping[str, str]) -> str:
    return ", ".join(names.get(label, label) for label in labels)


def _fewer_frames(results: Results, metrics: Sequence[str], protocol: Protocol) -> list[str]:
    """State the number of frames with values, if it is less than one per frame or pair."""
    table, count = results.table, protocol.frames.count
    framed = table[table["metric"].isin(metrics) & (table["frame"] >= 0)]
    keys = ["metric", "scene", "method", "variant", "view"]
    sentences = []
    for metric, counts in (
        framed.groupby(keys, sort=False, dropna=False).size().groupby("metric", sort=False)
    ):
        low, high = int(counts.min()), int(counts.max())
        if low < count - 1:
            sentences.append(
                f"{metric} is of {low if low == high else f'{low} to {high}'} of {count} frames."
            )
    return sentences


def _versions(results: Results) -> list[str]:
    """Name the packages of which more than one version made these values."""
    versions = results.versions
    mixed = [
        f"{name} {version}"
        for name, version in versions.items()
        if BETWEEN in version and name != OWN_PACKAGE
    ]
    return [f"Values were computed by several versions: {', '.join(mixed)}."] if mixed else []
