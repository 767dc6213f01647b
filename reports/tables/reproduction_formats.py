"""The paper's values beside ours as Markdown, CSV and as blocks of a page."""

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ggvs_eval.reports.model.table import Cell, Column, Row, Table, rank
from ggvs_eval.reports.tables.published import CAVEATS, SOURCE, is_higher_better
from ggvs_eval.reports.tables.reproduction import MEANING, STATUSES, TABLES, Reproduction
from ggvs_eval.reports.tables.table_formats import escape_markdown, markdown_table

HEADS = ("Method", "Metric", "Paper", "Ours here", "Status", "Why")
WORDS = (0, 1, 4, 5)  # columns without numbers
CSV_HEAD = ("table", "dataset", "method", "metric", "unit", "paper", "ours", "lo", "hi", "difference", "status", "reason")
TIMING = "timing"


@dataclass(frozen=True)
class Block:
    """The values of one of the paper's tables on one data set.

    Attributes:
        title: table and data set.
        entries: its values.
        summary: how many have which status.
    """

    title: str
    entries: tuple[Reproduction, ...]
    summary: str


def blocks(entries: Sequence[Reproduction]) -> tuple[Block, ...]:
    """The values by table and data set, in the order of the paper."""
    keys = dict.fromkeys((entry.table, entry.dataset) for entry in entries)
    found = []
    for table, dataset in keys:
        own = tuple(entry for entry in entries if (entry.table, entry.dataset) == (table, dataset))
        found.append(Block(f"{TABLES[table]} on {dataset}", own, count_words(own)))
    return tuple(found)


def count_words(entries: Sequence[Reproduction]) -> str:
    """How many values have which status: ``3 reproduced, 17 data absent``."""
    counts = Counter(entry.status for entry in entries)
    return ", ".join(f"{counts[status]} {status}" for status in STATUSES if counts[status])


def reproduction_markdown(entries: Sequence[Reproduction]) -> str:
    """One table per table of the paper and data set, one line per value, what the words mean at the end."""
    parts = [f"# The paper's values and ours\n\n{len(entries)} published values: {count_words(entries)}."]
    for block in blocks(entries):
        table = markdown_table(HEADS, map(_words, block.entries), words=WORDS)
        parts.append(f"## {block.title}\n\n{block.summary}.\n\n{table}")
    notes = "\n".join(f"- {escape_markdown(note)}" for note in (MEANING, f"Published values: {SOURCE}", *CAVEATS))
    return "\n\n".join([*parts, notes]) + "\n"


def reproduction_csv(entries: Sequence[Reproduction]) -> str:
    """One line per value; ours, its bounds and its difference unrounded, and empty where nothing was measured."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_HEAD)
    for entry in entries:
        ours = entry.ours
        difference = None if ours.value is None else ours.value - float(entry.paper)
        numbers = ["" if number is None else repr(number) for number in (ours.value, ours.low, ours.high, difference)]
        head = (entry.table, entry.dataset, entry.method, entry.metric, entry.unit, entry.paper)
        writer.writerow([*head, *numbers, entry.status, entry.reason])
    return text.getvalue()


def _words(entry: Reproduction) -> tuple[str, ...]:
    metric = f"{entry.metric} ({entry.unit})" if entry.unit else entry.metric
    ours = f"{entry.ours.text} {entry.ours.spread}".strip()
    return tuple(map(escape_markdown, (entry.method, metric, entry.paper, ours, entry.status, entry.reason)))


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
