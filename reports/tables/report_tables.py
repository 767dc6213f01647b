"""The tables of a report: quality, consistency, each view by itself, time per stage."""

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import pandas as pd

from ggvs_eval.reports.model.measured import MeasuredRun, label_of, reference_remarks, reference_rows, without_labels
from ggvs_eval.reports.model.metric_note import MetricNote, note_groups
from ggvs_eval.reports.model.table import Cell, Column, Row, RowKind, Table, measured_cell, rank
from ggvs_eval.reports.tables.community import community_rows, describe_published
from ggvs_eval.reports.tables.published import published_rows
from ggvs_eval.results import Results
from ggvs_eval.statistics.intervals import LEVEL, Interval, intervals
from ggvs_eval.statistics.paired import Standing, rank_methods

CHOSEN_FOR = {"nearest": "", "coverage": ", chosen for what they see of the target"}  # words after the number of sources
PUBLISHED_GROUPS = ("quality", "consistency")


@dataclass(frozen=True)
class Certainty:
    """Statistical certainty of one metric's numbers.

    Attributes:
        intervals: label -> interval, or why there is none.
        standing: who is best and who ties; None where there are fewer than two methods.
    """

    intervals: Mapping[str, Interval]
    standing: Standing | None

    @property
    def told(self) -> frozenset[str] | None:
        """Labels of the best and its ties; None where nobody could be compared with the best."""
        if self.standing is None or (self.standing.comparisons and not self.standing.p_values):
            return None
        return self.standing.ties

    @property
    def undecided(self) -> str:
        """Reason why no method is named as the best; empty where one is."""
        return "" if self.standing is None else self.standing.short

    @property
    def refusal(self) -> str:
        """Reason why some method has no interval; empty where all have one."""
        return next((interval.note for interval in self.intervals.values() if interval.low is None), "")

    def interval(self, label: str) -> Interval | None:
        """Interval of a method; its note also says why it was not compared with the best."""
        interval = self.intervals.get(label)
        why = "" if self.standing is None else self.standing.untested.get(label, "")
        if interval is None or not why or why == interval.note:
            return interval
        note = "; ".join(filter(None, (interval.note, f"not compared with the best: {why}")))
        return Interval(interval.value, interval.low, interval.high, note)


def main_tables(runs: Sequence[MeasuredRun], results: Results) -> tuple[Table, ...]:
    """Quality and consistency per dataset: means over frames, then views, then scenes.

    Args:
        runs: at least one, all under one protocol.
        results: their results in one, see `ggvs_eval.results.merge_results`.

    Returns:
        Per dataset one table for each group of the metrics that the protocol asks for, in its order.
    """
    groups = note_groups(list(runs[0].metrics.values()))
    summary = results.summary()
    tables = []
    for dataset in dict.fromkeys(str(name) for name in summary.index.get_level_values("dataset")):
        tables += [_main_table(dataset, notes, runs, summary, results) for notes in groups.values()]
    return tuple(tables)


def _main_table(
    dataset: str, notes: tuple[MetricNote, ...], runs: Sequence[MeasuredRun], summary: pd.DataFrame, results: Results
) -> Table:
    key, title, metrics = notes[0].group, notes[0].group_title, tuple(note.name for note in notes)
    columns = tuple(metric_column(note) for note in notes)
    here = cast(pd.DataFrame, summary.xs(dataset, level="dataset"))
    partial = results.provenance.get("partial", {})
    certain = {note.name: _certainty(note, results, dataset, partial) for note in notes}
    rows = measured_rows(runs, here, metrics, notes, results, certain)
    told = [_told_rows(certain[metric], row_labels(runs, here)) for metric in metrics]
    references = [reference for run in runs for reference in run.references]
    grey = reference_rows(references, key, notes)
    grey += published_rows(key, dataset, metrics) if key in PUBLISHED_GROUPS else ()
    protocol, scenes = runs[0].protocol, [run.scene for run in runs]
    community = community_rows(protocol, scenes, metrics)
    grey += community
    published = describe_published(protocol, scenes) if community or key == PUBLISHED_GROUPS[0] else []
    frames, views = _count(protocol.frames.count, "frame"), _count(len(protocol.views.test), "view")
    sources = f"K = {protocol.synthesis.k} source views{CHOSEN_FOR[protocol.synthesis.sources]}"
    means = f"Mean over {frames}, then {views}, then scenes; {sources}."
    if key == "path":
        means = f"Over the whole camera path, at one instant; {sources}."
    marks = [f"{label} is {mark}; it is not ranked." for label, mark in partial.items()]
    caption = " ".join([means, *marks, *_certainty_captions(certain), *reference_remarks(references, key, notes), *published])
    undecided = {metric: certainty.undecided for metric, certainty in certain.items()}
    return Table(key, title, caption, columns, rank(columns, rows, told) + grey, dataset, undecided)


def _certainty(note: MetricNote, results: Results, dataset: str, partial: Collection[str]) -> Certainty:
    whole = without_labels(results, partial)
    interval_of = intervals(whole, note.name, dataset)
    several = sum(not math.isnan(one.value) for one in interval_of.values()) > 1
    standing = rank_methods(whole, note.name, note.higher_is_better, dataset) if several else None
    return Certainty(interval_of, standing)


def _told_rows(certainty: Certainty, labels: Sequence[str]) -> frozenset[int] | None:
    """Places of the best and its ties among the rows."""
    told = certainty.told
    return None if told is None else frozenset(at for at, label in enumerate(labels) if label in told)


def _certainty_captions(certain: Mapping[str, Certainty]) -> list[str]:
    """Write captions: the meaning of ± and bold in this table, and which numbers have no interval."""
    level = f"{100 * LEVEL:.0f} %"
    bounded = [one for certainty in certain.values() for one in certainty.intervals.values() if one.low is not None]
    given = "".join(f", {note}" for note in dict.fromkeys(interval.note.partition(";")[0] for interval in bounded) if note)
    captions = [f"±: {level} interval, by the correlation over time that each clip allows{given}."] if bounded else []
    ranked = [certainty for certainty in certain.values() if certainty.standing]
    if any(certainty.told for certainty in ranked):
        captions.append(f"Bold: best, and what cannot be told from it (paired, {level}).")
    by_digits = [metric for metric, certainty in certain.items() if certainty.standing and certainty.told is None]
    if by_digits:
        captions.append(f"Bold in {', '.join(by_digits)}: best to the printed digits, nothing could be compared.")
    short, reasons = defaultdict(list), defaultdict(list)
    for metric, certainty in certain.items():
        short[certainty.undecided].append(metric)
        reasons[certainty.refusal].append(metric)
    captions += [f"No winner in {', '.join(names)}: {reason}." for reason, names in short.items() if reason]
    return captions + [f"No interval for {', '.join(names)}: {reason}." for reason, names in reasons.items() if reason]


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
        caption = f"Mean over frames in each test view; {'higher' if note.higher_is_better else 'lower'} is better."
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
    certain: Mapping[str, Certainty] | None = None,
) -> tuple[Row, ...]:
    """A row per method, in the order of the runs' methods.

    Args:
        runs: who was measured, under which names.
        values: rows (method, variant).
        keys: columns of `values` to show.
        notes: metric of each of these columns.
        results: knows why a value may be absent.
        certain: metric -> what is known of its numbers; None shows numbers alone.
    """
    by_label = {label_of(method, variant): values.loc[(method, variant)] for method, variant in values.index}
    rows = []
    for label in row_labels(runs, values):
        names = next((run for run in runs if label in run.labels), runs[0])
        cells = [
            _cell(
                note,
                by_label[label].get(key) if label in by_label else None,
                results,
                certain[note.name].interval(label) if certain else None,
                label in names.partial,
            )
            for key, note in zip(keys, notes, strict=True)
        ]
        kind: RowKind = "partial" if label in names.partial else "ours" if label in names.ours else "measured"
        rows.append(Row(names.name(label), tuple(cells), kind))
    return tuple(rows)


def _cell(note: MetricNote, value: float | None, results: Results, interval: Interval | None, is_partial: bool) -> Cell:
    absent = "partial renders" if is_partial else "no value in the results; run `ggvs-eval score` again"
    reason = results.not_computed.get(note.name, absent)
    return measured_cell(None if value is None else float(value), reason, interval, note.decimals)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
