"""Who is best and by how much, in words and places of a drawing: what a page says first."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import pandas as pd

from ggvs_eval.reports.model.measured import MeasuredRun, without_labels
from ggvs_eval.reports.model.table import Cell, Column, Table, format_value
from ggvs_eval.reports.tables.leaders import HEADLINES, Leader, leaders
from ggvs_eval.reports.tables.report_tables import row_labels
from ggvs_eval.results import Results
from ggvs_eval.statistics.intervals import LEVEL
from ggvs_eval.statistics.paired import Comparison, rank_methods

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
        label: folder name.
        name: to show.
        number: counts the methods of the group, so that it has the colour of its curves.
        cell: value and interval.
        place: of the value in the drawing, per cent from the left; None where it is not finite.
        span: ends of the interval likewise; None where there is none.
    """

    label: str
    name: str
    number: int
    cell: Cell
    place: float | None
    span: tuple[float, float] | None


@dataclass(frozen=True)
class Verdict:
    """The answer of a group of runs.

    Attributes:
        headline: who is best, or that there is a tie.
        margin: by how much, with its interval.
        column: the metric that this is in.
        meaning: what it measures, in plain words.
        contenders: every method that competes, the best first.
        others: name of a method -> the other metrics that it alone is best in.
        tied: the other metrics in which no winner can be named.
    """

    headline: str
    margin: str
    column: Column
    meaning: str
    contenders: tuple[Contender, ...]
    others: dict[str, list[str]]
    tied: tuple[str, ...]

    def shown(self, run: MeasuredRun) -> tuple[str, ...]:
        """Whose pictures say most of a run: the best, and ours beside it, or the runner-up where ours is the best."""
        labels = [one.label for one in self.contenders if one.label in run.pictured]
        beside = [label for label in labels[1:] if label in run.ours] if labels and labels[0] not in run.ours else []
        return tuple(dict.fromkeys([*labels[:1], *beside, *labels[1:]]))[:2]


def evaluate_verdict(runs: Sequence[MeasuredRun], results: Results, tables: Sequence[Table]) -> Verdict | None:
    """Say who is best in the first headline metric; None where nothing is ranked.

    Args:
        runs: of one protocol.
        results: theirs in one.
        tables: main tables of these results.

    Reading:
        The paper names no single measure of quality. The first one of its own tables that was measured is the headline (PSNR,
        if it was), and who leads the others is said beside it.
    """
    all_leaders = leaders(tables)
    if not all_leaders:
        return None
    first = min(all_leaders, key=lambda one: HEADLINES.index(one.column.name) if one.column.name in HEADLINES else len(HEADLINES))
    table = next(one for one in tables if one.dataset == first.dataset and first.column in one.columns)
    at, labels = table.columns.index(first.column), _labels(runs, results, first.dataset)
    competing = [
        (label, row.name, row.cells[at])
        for label, row in zip(labels, table.rows, strict=False)
        if row.competes and row.cells[at].value is not None and not row.cells[at].unranked
    ]
    sign = 1.0 if first.column.higher_is_better else -1.0
    competing.sort(key=lambda one: -sign * cast(float, one[2].value))  # stable
    places = _Scale([cell for *_, cell in competing])
    contenders = tuple(
        Contender(label, name, labels.index(label), cell, places.at(cell.value), places.span(cell))
        for label, name, cell in competing
    )
    alone = sum(not row.is_grey and row.cells[at].value is not None for row in table.rows) == 1
    headline, margin = _words(first, contenders, runs, results, alone)
    others: dict[str, list[str]] = {}
    for leader in all_leaders:
        if leader is not first:
            others.setdefault("" if leader.undecided or leader.ties else leader.name, []).append(leader.column.name)
    tied = tuple(others.pop("", ()))
    meaning = PLAIN.get(first.column.name, first.column.describe)
    return Verdict(headline, margin, first.column, meaning, contenders, others, tied)


def _labels(runs: Sequence[MeasuredRun], results: Results, dataset: str) -> list[str]:
    """Labels of the rows of a main table."""
    return row_labels(runs, cast(pd.DataFrame, results.summary().xs(dataset, level="dataset")))


def _words(
    first: Leader, contenders: Sequence[Contender], runs: Sequence[MeasuredRun], results: Results, alone: bool
) -> tuple[str, str]:
    """Headline and margin."""
    best, column, decimals = contenders[0], first.column, runs[0].metrics[first.column.name].decimals
    unit = f" {column.unit}" if column.unit else ""
    if len(contenders) == 1:
        number = f"{best.cell.shown} {best.cell.spread}".strip() + unit
        if alone:
            return f"{best.name} was measured alone", number
        return "No winner can be named", f"{best.name} has {number}; the others were measured on other scenes, views or frames"
    others = set(results.row_labels) - {one.label for one in contenders}
    ranked = without_labels(results, others)
    standing = rank_methods(ranked, column.name, bool(column.higher_is_better), first.dataset)
    rival = next((one for one in contenders[1:] if one.name in first.ties), contenders[1])
    comparison = standing.comparisons.get(rival.label)
    if comparison is None:
        return f"{best.name} and {rival.name} are equal", f"{best.cell.shown}{unit} each"
    second = f"“{rival.name}”" if "," in rival.name else rival.name
    by = f"{format_value(abs(comparison.difference), decimals)}{unit}"
    interval = _interval(comparison, bool(column.higher_is_better), decimals, unit)
    if first.undecided:
        return "No winner can be named", f"{best.name} is {by} ahead of {second}; {first.undecided}"
    if first.ties:
        rivals = rival.name if len(first.ties) == 1 else f"{len(first.ties)} others"
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
