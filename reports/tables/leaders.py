"""Best method of each metric, the first thing on a page."""

from collections.abc import Sequence
from dataclasses import dataclass

from ggvs_eval.reports.model.table import Cell, Column, Row, Table

HEADLINES = ("PSNR", "SSIM", "LPIPS", "TCC", "STED", "SDT", "SDV")  # those of the paper's tables


@dataclass(frozen=True)
class Leader:
    """Best method in one column of a table.

    Attributes:
        dataset: that the table is of.
        ties: other methods that cannot be distinguished from it.
        undecided: why none is named as the best; empty where the first is.
    """

    column: Column
    dataset: str
    name: str
    cell: Cell
    ties: tuple[str, ...]
    undecided: str = ""


def leaders(tables: Sequence[Table], metrics: Sequence[str] = HEADLINES) -> tuple[Leader, ...]:
    """The best method of each wanted metric that has one; of the first table's metrics where none is wanted that was measured."""
    all_leaders = [leader for table in tables for leader in _leaders_of(table)]
    chosen = tuple(leader for leader in all_leaders if leader.column.name in metrics)
    return chosen or tuple(all_leaders[: len(tables[0].columns)] if tables else ())


def _leaders_of(table: Table) -> list[Leader]:
    """One per column that ranks methods; where none is marked as best, all of them tie."""
    column_leaders = []
    for at, column in enumerate(table.columns):
        measured = [row for row in table.rows if row.competes and row.cells[at].value is not None]
        having = [row for row in measured if not row.cells[at].unranked and column.higher_is_better is not None]
        best = [row for row in having if row.cells[at].best] or having
        if best:
            first = max(best, key=lambda row: _goodness(row, at, column))  # stable: of equals the upper one
            ties = tuple(row.name for row in best if row is not first)
            undecided = table.undecided.get(column.name, "") if len(measured) > 1 else ""
            column_leaders.append(Leader(column, table.dataset, first.name, first.cells[at], ties, undecided))
    return column_leaders


def _goodness(row: Row, at: int, column: Column) -> float:
    """A value whose larger is better."""
    value = row.cells[at].value
    if value is None:
        raise ValueError(f"{row.name}: marked as best in {column.name} without a value")
    return value if column.higher_is_better else -value
