"""A method's number beside the capture's ceiling and published values, and where its error lies."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from ggvs_eval.reports.model.table import Cell, Column, Table
from ggvs_eval.reports.tables.community import published_values
from ggvs_eval.reports.tables.error_budget import BUDGET_KEY
from ggvs_eval.reports.tables.published import read_published

USUAL = (10, 90)  # percentiles of published values
CAUSES = {
    "unseen": "places that no source camera sees",
    "wide": "colour and light over wide areas, as of cameras that differ",
    "misplaced": "in the wrong place, by wrong depth, poses or motion",
    "detail": "detail: blur, noise, and what belongs elsewhere altogether",
}


def describe_absolute(name: str, cell: Cell, column: Column, table: Table, budgets: Sequence[Table]) -> str:
    """One or two sentences on a method's number by itself; empty where there is nothing to hold it against.

    Args:
        table: the main table, whose grey rows have the ceilings of the capture.
        budgets: error budgets of the group's runs; the cause is of the first.

    Reading:
        The range is that of the values which this package has from papers, on whatever capture: it says whether a number is far
        from all of them, not more. The largest of the four parts of the squared error is named as the cause.
    """
    unit, at = f" {column.unit}" if column.unit else "", table.columns.index(column)
    beside = []
    ceilings = [row.cells[at].shown for row in table.rows if row.kind == "reference" and row.cells[at].value is not None]
    if ceilings:
        beside.append(f"a perfect rendering would have {ceilings[0]}{unit} on this capture")
    if usual := usual_range(column.name):
        low, high = usual
        beside.append(f"published methods have {low:.3g} to {high:.3g}{unit} on theirs")
    sentences = [f"{name} has {cell.shown}{unit}; {', and '.join(beside)}."] if beside else []
    if cause := largest_cause(name, budgets):
        sentences.append(cause)
    return " ".join(sentences)


@cache
def usual_range(metric: str) -> tuple[float, float] | None:
    """Range of four fifths of the published values of a metric; None where few are known."""
    of_paper = [values for methods in read_published("quality").values() for values in methods.values()]
    values = [float(each[metric]) for each in of_paper if metric in each]
    values += [float(each.value) for each in published_values() if each.metric == metric]
    if len(values) < 10:
        return None
    low, high = np.percentile(values, USUAL)
    return float(low), float(high)


def largest_cause(name: str, budgets: Sequence[Table]) -> str:
    """The largest part of a method's squared error, in words; empty where no error was taken apart."""
    rows = [(budget, row) for budget in budgets if budget.key == BUDGET_KEY for row in budget.rows if row.name == name]
    if not rows:
        return ""
    budget, row = rows[0]
    parts = zip(budget.columns, row.cells, strict=True)
    shares = {column.name: cell.value for column, cell in parts if column.name in CAUSES and cell.value}
    if not shares:
        return ""
    largest = max(shares, key=lambda part: shares[part] or 0.0)
    return f"{shares[largest]:.0f} % of its squared error is {CAUSES[largest]}."
