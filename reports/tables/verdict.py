"""Best method and its margin, in words and as a drawing: the head of a page."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import pandas as pd

from ggvs_eval.progress import counted
from ggvs_eval.reports.model.measured import MeasuredRun, without_labels
from ggvs_eval.reports.model.table import Cell, Column, Table, format_value
from ggvs_eval.reports.tables.absolute import describe_absolute
from ggvs_eval.reports.tables.certainty import Certainty, assess
from ggvs_eval.reports.tables.leaders import HEADLINES, Leader, leaders
from ggvs_eval.reports.tables.report_tables import row_labels
from ggvs_eval.results import Results
from ggvs_eval.statistics.intervals import LEVEL
from ggvs_eval.statistics.paired import Comparison, compare

PLAIN = {
    "PSNR": "how close each picture comes to the recorded one",
    "SSIM": "how alike the structure of each picture is to the recorded one",
    "LPIPS": "how different each picture looks from the recorded one",
}
RIM = 4.0  # per cent of the drawing that stay free on either side


@dataclass(frozen=True)
class Contender:
    """One method in the headline metric.

    Attributes:
        number: counts the methods of the group, so that it has the colour of its curves.
        place: of the value in the drawing, per cent from the left; None where it is not finite.
        span: ends of the interval in the same way; None where there is none.
        worth: of a variant of ours, its difference to ours in words; empty otherwise.
    """

    label: str
    name: str
    number: int
    cell: Cell
    place: float | None
    span: tuple[float, float] | None
    worth: str = ""


@dataclass(frozen=True)
class Verdict:
    """The answer of a group of runs.

    Attributes:
        headline: who is best, or that none can be named.
        margin: by how much, with its interval.
        absolute: the first's number beside the capture's ceiling and published ones, and where its error lies; empty where
            there is nothing to hold it against.
        column: the metric that this is in.
        meaning: what it measures, in plain words.
        contenders: every method that competes, the best first; of ours the method itself, unless ours alone were measured.
        parts: variants of ours, with what each lacks or adds.
        others: name of a method -> the other metrics that it alone is best in.
        tied: the other metrics in which no winner can be named.
    """

    headline: str
    margin: str
    absolute: str
    column: Column
    meaning: str
    contenders: tuple[Contender, ...]
    parts: tuple[Contender, ...]
    others: dict[str, list[str]]
    tied: tuple[str, ...]

    def shown(self, run: MeasuredRun) -> tuple[str, ...]:
        """Methods whose pictures say most of a run: the best, and ours beside it, or the runner-up where ours is the best."""
        labels = [one.label for one in (*self.contenders, *self.parts) if one.label in run.pictured]
        beside = [label for label in labels[1:] if label in run.ours] if labels and labels[0] not in run.ours else []
        return tuple(dict.fromkeys([*labels[:1], *beside, *labels[1:]]))[:2]


@dataclass(frozen=True)
class _Field:
    """Contenders in a metric.

    Attributes:
        dataset: that the table is of.
        ranked: label, name and cell of each contender, the best first.
        parts: the same of ours' variants.
        certainty: standing of the contenders alone.
    """

    column: Column
    dataset: str
    ranked: list[tuple[str, str, Cell]]
    parts: list[tuple[str, str, Cell]]
    certainty: Certainty

    @property
    def ties(self) -> list[str]:
        """Names of those that cannot be distinguished from the first."""
        told = self.certainty.told
        return [name for label, name, _ in self.ranked[1:] if told is None or label in told]


def evaluate_verdict(
    runs: Sequence[MeasuredRun], results: Results, tables: Sequence[Table], budgets: Sequence[Table] = ()
) -> Verdict | None:
    """Say who is best in the first headline metric; None where nothing is ranked.

    Reading:
        The paper names no single measure of quality. The first one of its own tables that was measured is the headline (PSNR,
        if it was), and who leads the others is said beside it. A method does not compete with its own ablations: of ours the one
        without a variant stands for all, and the others say what each part is worth.
    """
    all_leaders = leaders(tables)
    if not all_leaders:
        return None
    first = min(all_leaders, key=lambda one: HEADLINES.index(one.column.name) if one.column.name in HEADLINES else len(HEADLINES))
    fields = [_field(leader, runs, results, tables) for leader in all_leaders]
    field = fields[all_leaders.index(first)]
    table = _table_of(first, tables)
    at, labels = table.columns.index(first.column), _labels(runs, results, first.dataset)
    places = _Scale([cell for *_, cell in (*field.ranked, *field.parts)])
    contenders, parts = (
        tuple(
            Contender(label, name, labels.index(label), cell, places.at(cell.value), places.span(cell))
            for label, name, cell in side
        )
        for side in (field.ranked, field.parts)
    )
    parts = tuple(replace(part, worth=_worth(part, contenders, first, runs, results)) for part in parts)
    alone = sum(not row.is_grey and row.cells[at].value is not None for row in table.rows) == 1
    headline, margin = _words(field, contenders, runs, alone)
    others: dict[str, list[str]] = {}
    for each in fields:
        if each is not field and len(each.ranked) > 1:
            others.setdefault("" if each.certainty.undecided or each.ties else each.ranked[0][1], []).append(each.column.name)
    tied = tuple(others.pop("", ()))
    meaning = PLAIN.get(first.column.name, first.column.describe)
    absolute = describe_absolute(contenders[0].name, contenders[0].cell, first.column, table, budgets)
    return Verdict(headline, margin, absolute, first.column, meaning, contenders, parts, others, tied)


def _table_of(leader: Leader, tables: Sequence[Table]) -> Table:
    return next(one for one in tables if one.dataset == leader.dataset and leader.column in one.columns)


def _labels(runs: Sequence[MeasuredRun], results: Results, dataset: str) -> list[str]:
    return row_labels(runs, cast(pd.DataFrame, results.summary().xs(dataset, level="dataset")))


def _field(leader: Leader, runs: Sequence[MeasuredRun], results: Results, tables: Sequence[Table]) -> _Field:
    """Contenders in a column, ours represented by one."""
    table, column = _table_of(leader, tables), leader.column
    at, labels = table.columns.index(column), _labels(runs, results, leader.dataset)
    competing = [
        (label, row.name, row.cells[at])
        for label, row in zip(labels, table.rows, strict=False)
        if row.competes and row.cells[at].value is not None and not row.cells[at].unranked
    ]
    sign = 1.0 if column.higher_is_better else -1.0
    competing.sort(key=lambda one: -sign * cast(float, one[2].value))  # stable
    variants = _variants([label for label, *_ in competing], frozenset().union(*(run.ours for run in runs)))
    ranked = [one for one in competing if one[0] not in variants]
    own = without_labels(results, set(results.row_labels) - {label for label, *_ in ranked})
    certainty = assess(runs[0].metrics[column.name], own, leader.dataset)
    return _Field(column, leader.dataset, ranked, [one for one in competing if one[0] in variants], certainty)


def _variants(competing: Sequence[str], ours: frozenset[str]) -> frozenset[str]:
    """Labels of ours that another one stands for: the plainest, where there are others to compete with."""
    own = [label for label in competing if label in ours]
    if len(own) == len(competing):
        return frozenset()
    plainest = min(own, key=lambda label: ("+" in label, len(label)), default="")
    return frozenset(own) - {plainest}


def _worth(part: Contender, contenders: Sequence[Contender], first: Leader, runs: Sequence[MeasuredRun], results: Results) -> str:
    """Difference of a variant to ours, with its interval where there is one."""
    main = next(one for one in contenders if any(one.label in run.ours for run in runs))
    difference = compare(results, first.column.name, part.label, main.label, first.dataset)
    decimals = runs[0].metrics[first.column.name].decimals
    sign = "\N{MINUS SIGN}" if difference.difference < 0 else "+"
    worth = f"{sign}{format_value(abs(difference.difference), decimals)}"
    if difference.low is None or difference.high is None:
        return worth
    return f"{worth} ± {format_value((difference.high - difference.low) / 2, decimals)}"


def _words(field: _Field, contenders: Sequence[Contender], runs: Sequence[MeasuredRun], alone: bool) -> tuple[str, str]:
    best, column, decimals = contenders[0], field.column, runs[0].metrics[field.column.name].decimals
    unit = f" {column.unit}" if column.unit else ""
    if len(contenders) == 1:
        number = f"{best.cell.shown} {best.cell.spread}".strip() + unit
        if alone:
            return f"{best.name} was measured alone", number
        if any(label in run.results.spoilt for run in runs for label in run.labels):
            return f"Only {best.name} is ranked", number
        return "No winner can be named", f"{best.name} has {number}; the others were measured on other scenes, views or frames"
    rival = next((one for one in contenders[1:] if one.name in field.ties), contenders[1])
    standing = field.certainty.standing
    comparison = standing.comparisons.get(rival.label) if standing else None
    if comparison is None:
        return f"{best.name} and {rival.name} are equal", f"{best.cell.shown}{unit} each"
    second = f"“{rival.name}”" if "," in rival.name else rival.name
    by = f"{format_value(abs(comparison.difference), decimals)}{unit}"
    interval = _interval(comparison, bool(column.higher_is_better), decimals, unit)
    if field.certainty.undecided:
        frames, views = runs[0].protocol.frames.count, len(runs[0].protocol.views.test)
        looked_at = f"{counted(frames, 'frame')} of {counted(views, 'view')}"
        return f"No winner can be named from {looked_at}", f"{best.name} is {by} ahead of {second}; {field.certainty.undecided}"
    if field.ties:
        rivals = rival.name if len(field.ties) == 1 else f"{len(field.ties)} others"
        return (
            f"{best.name} and {rivals} tie",
            f"{by} between {best.name} and {second} is too little to tell them apart{interval}",
        )
    return f"{best.name} is best", f"{by} ahead of {second}, the next best{interval}"


def _interval(comparison: Comparison, higher_is_better: bool, decimals: int | None, unit: str) -> str:
    """Bounds of how far the best lies ahead."""
    if comparison.low is None or comparison.high is None:
        return ""
    low, high = (-comparison.high, -comparison.low) if higher_is_better else (comparison.low, comparison.high)
    shown = [format_value(bound, decimals).replace("-", "−") for bound in (low, high)]
    return f" ({100 * LEVEL:.0f}\N{NO-BREAK SPACE}% interval {shown[0]} to {shown[1]}{unit})"


class _Scale:
    """Places in a drawing that holds all finite values and intervals."""

    def __init__(self, cells: Sequence[Cell]) -> None:
        numbers = [number for cell in cells for number in (cell.value, cell.low, cell.high) if number is not None]
        finite = [number for number in numbers if math.isfinite(number)] or [0.0]
        self.low, self.size = min(finite), max(finite) - min(finite)

    def at(self, value: float | None) -> float | None:
        """Per cent from the left."""
        if value is None or not math.isfinite(value):
            return None
        return round(RIM + (100.0 - 2.0 * RIM) * ((value - self.low) / self.size if self.size else 0.5), 2)

    def span(self, cell: Cell) -> tuple[float, float] | None:
        """Both ends of an interval."""
        ends = self.at(cell.low), self.at(cell.high)
        return None if ends[0] is None or ends[1] is None else (ends[0], ends[1])
