"""Differences of two methods as text and CSV."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ggvs_eval.files.atomic import write_text
from ggvs_eval.reports.model.table import format_value, signed
from ggvs_eval.reports.tables.compare_runs import (
    Difference,
    differences,
    method_sides,
    require_runs,
    run_sides,
    what_else_differs,
)
from ggvs_eval.reports.tables.table_formats import csv_text

HEADS = ("metric", "view", "first", "second", "difference", "95 % interval", "p (Holm)", "verdict")
CSV_HEAD = (
    *("method", "metric", "unit", "view", "first", "second", "difference"),
    *("lo", "hi", "p_value", "significant", "verdict", "given"),
)


def differences_text(differences: Sequence[Difference]) -> str:
    """Columns under each other; a line per metric, and per view where asked for; all p values after Holm's correction."""
    rows = [HEADS, *map(_line, differences)]
    widths = [max(len(row[at]) for row in rows) for at in range(len(HEADS))]
    lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    given: dict[str, list[str]] = {}
    for one in differences:
        if one.comparison.p_value is not None and not one.view and one.comparison.note:
            given.setdefault(one.comparison.note, []).append(one.metric)
    notes = [f"Intervals of the means of {', '.join(metrics)}: {note}." for note, metrics in given.items()]
    return "\n".join(
        [*lines, *notes, *(["Intervals of single views: given the view."] if any(one.view for one in differences) else [])]
    )


def differences_csv(differences: Mapping[str, Sequence[Difference]]) -> str:
    """One line per pair of methods, metric and view, numbers unrounded."""
    rows: list[list[object]] = []
    for name, one in ((name, one) for name, several in differences.items() for one in several):
        bounds = [
            "" if value is None else repr(value) for value in (one.comparison.low, one.comparison.high, one.comparison.corrected)
        ]
        numbers = [repr(value) for value in (one.first, one.second, one.comparison.difference)]
        head = [name, one.metric, one.note.unit, one.view]
        rows.append([*head, *numbers, *bounds, one.is_significant, one.verdict, one.comparison.note])
    return csv_text(CSV_HEAD, rows)


def write_comparison(first: str, second: str, run: Path | None, views: bool = False, out: Path | None = None) -> str:
    """Compare two runs, or two methods of one.

    Raises:
        ResultsError: different protocols or captured frames, no such run or method, or nothing in common.
    """
    require_runs(first, second, run)
    pairs = run_sides(Path(first), Path(second)) if run is None else (method_sides(run, first, second),)
    notes = what_else_differs(Path(first), Path(second)) if run is None else []
    by_pair = {
        one.name if run is None else f"{one.name} against {other.name}": differences(one, other, run or Path(first))
        for one, other in pairs
    }
    if out is not None:
        write_text(out, differences_csv(by_pair))
    parts = [f"{name}\n{differences_text([one for one in each if views or not one.view])}" for name, each in by_pair.items()]
    return "\n\n".join([f"first: {first}, second: {second}", *notes, *parts])


def _line(one: Difference) -> tuple[str, ...]:
    low, high = one.comparison.low, one.comparison.high
    shown = [format_value(value, one.note.decimals) for value in (one.first, one.second)]
    digits = one.note.decimals
    interval = "none" if low is None or high is None else f"{signed(low, digits)} to {signed(high, digits)}"
    p_value = "none" if one.comparison.corrected is None else f"{one.comparison.corrected:.4f}"
    name = f"{one.metric} ({one.note.unit})" if one.note.unit else one.metric
    return name, one.view or "all", *shown, signed(one.comparison.difference, digits), interval, p_value, one.verdict
