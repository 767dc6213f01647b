"""The paper's tables as it lays them out: its values shaded as it shades them, and below each method what it has here."""

from collections.abc import Sequence
from dataclasses import replace

from ggvs_eval.reports.model.table import Cell, Column, Row, Table, rank
from ggvs_eval.reports.tables.published import SOURCE, is_higher_better
from ggvs_eval.reports.tables.reproduction import TABLES, Reproduction
from ggvs_eval.reports.tables.reproduction_formats import blocks

TIMING = "timing"


def paper_tables(entries: Sequence[Reproduction]) -> tuple[Table, ...]:
    """One table per table of the paper and data set.

    Args:
        entries: every published value and its standing, see `ggvs_eval.reports.tables.reproduction.reproduce`.

    Returns:
        Grey rows with the paper's values, ranked and shaded among themselves, each followed by a row of ours, which says the
        status where nothing was measured.
    """
    return tuple(_table(block.title, block.summary, block.entries) for block in blocks(entries))


def _table(title: str, summary: str, entries: Sequence[Reproduction]) -> Table:
    table, dataset = entries[0].table, entries[0].dataset
    columns = tuple(_column(entry) for entry in {entry.metric: entry for entry in entries}.values())
    methods = dict.fromkeys(entry.method for entry in entries)
    found = {(entry.method, entry.metric): entry for entry in entries}
    published = [Row(name, tuple(_paper_cell(found.get((name, column.name))) for column in columns)) for name in methods]
    rows: list[Row] = []
    for name, row in zip(methods, rank(columns, published), strict=True):
        here = tuple(_our_cell(found.get((name, column.name))) for column in columns)
        rows += [replace(row, name=f"{name} (paper)", kind="published"), Row(f"{name}, here", here)]
    caption = f"{summary[0].upper()}{summary[1:]}; reproduction.md says why. Paper: {SOURCE}."
    return Table(f"reproduction-{table}", f"{TABLES[table]}, the paper's and ours", caption, columns, tuple(rows), dataset)


def _column(entry: Reproduction) -> Column:
    """Head of a metric; times are not ranked, for each belongs to its machine."""
    return Column(entry.metric, entry.unit, None if entry.table == TIMING else is_higher_better(entry.metric))


def _paper_cell(entry: Reproduction | None) -> Cell:
    return Cell("not reported") if entry is None else Cell(entry.paper, float(entry.paper))


def _our_cell(entry: Reproduction | None) -> Cell:
    if entry is None:
        return Cell("nothing to compare")
    return Cell(entry.status) if entry.ours.value is None else entry.ours
