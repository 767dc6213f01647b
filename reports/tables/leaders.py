"""Best method of each metric, as the judgements of the tables have it."""

from collections.abc import Sequence
from dataclasses import dataclass

from ggvs_eval.reports.model.table import Cell, Column, Table

HEADLINES = ("PSNR", "SSIM", "LPIPS", "TCC", "STED", "SDT", "SDV")  # those of the paper's tables


@dataclass(frozen=True)
class Leader:
    """Best method in one column of a table.

    Attributes:
        dataset: that the table is of.
        ties: other methods that cannot be distinguished from it.
        short: other methods against which the clip is too short to call it.
        is_winner: whether every other method is worse.
        undecided: why none is named as the best; empty where one is, or methods tie.
    """

    column: Column
    dataset: str
    name: str
    cell: Cell
    ties: tuple[str, ...]
    short: tuple[str, ...]
    is_winner: bool
    undecided: str = ""


def leaders(tables: Sequence[Table], metrics: Sequence[str] = HEADLINES) -> tuple[Leader, ...]:
    """The best method of each wanted metric that has one; of the first table's metrics where none is wanted that was measured."""
    all_leaders = [leader for table in tables for leader in _leaders_of(table)]
    chosen = tuple(leader for leader in all_leaders if leader.column.name in metrics)
    return chosen or tuple(all_leaders[: len(tables[0].columns)] if tables else ())


def _leaders_of(table: Table) -> list[Leader]:
    """One per column that ranks methods."""
    rows = {row.label: row for row in table.rows if row.label}
    found = []
    for at, column in enumerate(table.columns):
        judgement = table.judgements.get(column.name)
        if judgement and judgement.best:
            named = lambda labels: tuple(rows[label].name for label in labels)  # noqa: E731
            ties, short = named(judgement.having("as good", "equal")), named(judgement.having("too short"))
            best = rows[judgement.best]
            cell, is_winner = best.cells[at], bool(judgement.winner)
            found.append(Leader(column, table.dataset, best.name, cell, ties, short, is_winner, judgement.undecided))
    return found
