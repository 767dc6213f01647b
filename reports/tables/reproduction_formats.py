"""The paper's values beside ours as Markdown, CSV and as blocks of a page."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ggvs_eval.reports.model.table import Cell, Column, Row, Table, rank
from ggvs_eval.reports.tables.published import CAVEATS, SOURCE, is_higher_better
from ggvs_eval.reports.tables.reproduction import MEANING, STATUSES, TABLES, Reproduction
from ggvs_eval.reports.tables.table_formats import csv_text, escape_markdown, markdown_table

HEADS = ("Paper's table", "Method", "Metric", "Paper", "Ours here", "Status", "Why")
WORDS = (0, 1, 2, 5, 6)  # columns without numbers
CSV_HEAD = ("table", "dataset", "method", "metric", "unit", "paper", "ours", "lo", "hi", "difference", "status", "reason")
TIMING = "timing"
METHODS_NAMED = 4  # from so many on a line counts methods


@dataclass(frozen=True)
class Block:
    """The values of one of the paper's tables on one data set."""

    title: str
    entries: tuple[Reproduction, ...]

    @property
    def lines(self) -> tuple["Line", ...]:
        """A line per measured value, and one for all values that are not measured for the same reason, where the first stands."""
        alike: dict[object, list[Reproduction]] = {}
        for number, entry in enumerate(self.entries):
            alike.setdefault(number if entry.ours.value is not None else (entry.status, entry.reason), []).append(entry)
        return tuple(_line(entries) for entries in alike.values())


@dataclass(frozen=True)
class Line:
    """Line on one published value, or on several that lack the same: words for each of `HEADS` but the first."""

    method: str
    metric: str
    paper: str
    ours: Cell
    status: str
    why: str


def _line(entries: Sequence[Reproduction]) -> Line:
    first, *others = entries
    methods = tuple(dict.fromkeys(entry.method for entry in entries))
    method = ", ".join(methods) if len(methods) < METHODS_NAMED else f"{len(methods)} methods"
    if not others:
        metric = f"{first.metric} ({first.unit})" if first.unit else first.metric
        return Line(method, metric, first.paper, first.ours, first.status, first.why)
    metrics = ", ".join(dict.fromkeys(entry.metric for entry in entries))
    return Line(method, metrics, f"{len(entries)} values", first.ours, first.status, first.reason)


def blocks(entries: Sequence[Reproduction]) -> tuple[Block, ...]:
    """The values by table and data set, in the order of the paper."""
    by_table: dict[tuple[str, str], list[Reproduction]] = {}
    for entry in entries:
        by_table.setdefault((entry.table, entry.dataset), []).append(entry)
    return tuple(Block(f"{TABLES[table]} on {dataset}", tuple(own)) for (table, dataset), own in by_table.items())


def count_words(entries: Sequence[Reproduction]) -> str:
    """Count the values of each status, in words: ``3 reproduced, 17 data absent``."""
    counts = Counter(entry.status for entry in entries)
    return ", ".join(f"{counts[status]} {status}" for status in STATUSES if counts[status])


def reproduction_markdown(entries: Sequence[Reproduction]) -> str:
    """One table of the paper's values, those grouped that are not measured for one reason; what the words mean at the end."""
    head = f"# The paper's values and ours\n\n{len(entries)} published values: {count_words(entries)}."
    rows = [_words(block.title, line) for block in blocks(entries) for line in block.lines]
    notes = (MEANING, "Every value by itself: reproduction.csv", f"Published values: {SOURCE}", *CAVEATS)
    closing = "\n".join(f"- {escape_markdown(note)}" for note in notes)
    return "\n\n".join([head, markdown_table(HEADS, rows, words=WORDS), closing]) + "\n"


def reproduction_csv(entries: Sequence[Reproduction]) -> str:
    """One line per value; ours, its bounds and its difference unrounded, and empty where nothing was measured."""
    rows = []
    for entry in entries:
        ours = entry.ours
        difference = None if ours.value is None else ours.value - float(entry.paper)
        numbers = ["" if number is None else repr(number) for number in (ours.value, ours.low, ours.high, difference)]
        head = (entry.table, entry.dataset, entry.method, entry.metric, entry.unit, entry.paper)
        rows.append([*head, *numbers, entry.status, entry.why])
    return csv_text(CSV_HEAD, rows)


def _words(title: str, line: Line) -> tuple[str, ...]:
    ours = f"{line.ours.shown} {line.ours.spread}".strip()
    return tuple(map(escape_markdown, (title, line.method, line.metric, line.paper, ours, line.status, line.why)))


def paper_tables(entries: Sequence[Reproduction]) -> tuple[Table, ...]:
    """One table per table of the paper and data set.

    Returns:
        Grey rows with the paper's values, shaded among themselves, the best bold as the paper prints them, each followed by a
        row of ours, which says the status where nothing was measured.
    """
    return tuple(_table(block.entries) for block in blocks(entries))


def _table(entries: Sequence[Reproduction]) -> Table:
    table, dataset = entries[0].table, entries[0].dataset
    columns = tuple(_column(entry) for entry in {entry.metric: entry for entry in entries}.values())
    methods = dict.fromkeys(entry.method for entry in entries)
    entry_of = {(entry.method, entry.metric): entry for entry in entries}
    published = [
        Row(name, tuple(_paper_cell(entry_of.get((name, column.name))) for column in columns), label=name) for name in methods
    ]
    rows: list[Row] = []
    best = [_best(published, at, column) for at, column in enumerate(columns)]
    for name, row in zip(methods, rank(columns, published, best), strict=True):
        here = tuple(_our_cell(entry_of.get((name, column.name))) for column in columns)
        rows += [replace(row, name=f"{name} (paper)", kind="published"), Row(f"{name}, here", here)]
    summary = count_words(entries)
    caption = f"{summary[0].upper()}{summary[1:]}; reproduction.csv says why. Paper: {SOURCE}."
    return Table(f"reproduction-{table}", f"{TABLES[table]}, the paper's and ours", caption, columns, tuple(rows), dataset)


def _best(rows: Sequence[Row], at: int, column: Column) -> set[str]:
    """Methods of the best published value, which has no interval; none where all are the same."""
    values = {row.label: value for row in rows if (value := row.cells[at].value) is not None}
    top = (max if column.higher_is_better else min)(values.values(), default=None)
    best = {label for label, value in values.items() if value == top}
    return best if len(best) < len(values) else set()


def _column(entry: Reproduction) -> Column:
    """Head of a metric; times are not ranked, for each belongs to its machine."""
    return Column(entry.metric, entry.unit, None if entry.table == TIMING else is_higher_better(entry.metric))


def _paper_cell(entry: Reproduction | None) -> Cell:
    return Cell("not reported") if entry is None else Cell(entry.paper, float(entry.paper))


def _our_cell(entry: Reproduction | None) -> Cell:
    if entry is None:
        return Cell("nothing to compare")
    return Cell(entry.status) if entry.ours.value is None else entry.ours
