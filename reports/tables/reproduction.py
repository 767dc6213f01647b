"""Published cells of the paper next to this run's measurements and verdicts, as Markdown, CSV, and
on a page.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import (
    Cell,
    Column,
    Row,
    Table,
    format_value,
    measured_cell,
    rank,
)
from ggvs_eval.reports.section import Report, SectionContent
from ggvs_eval.reports.tables.published import (
    CAVEATS,
    HIGHER_IS_BETTER,
    PAPER,
    SOURCE,
    TIMING_WORDS,
    UNITS,
    ComparableRuns,
    find_comparable_runs,
    published_cell,
    published_values,
    read_lines,
)
from ggvs_eval.reports.tables.table_formats import (
    csv_text,
    escape_markdown,
    markdown_table,
    to_latex,
)
from ggvs_eval.reports.tables.timing import TIMINGS, evaluate_time
from ggvs_eval.results import label_of
from ggvs_eval.statistics.intervals import LEVEL, intervals

Status = Literal["reproduced", "differs", "data absent", "weights absent", "not run"]
STATUSES: tuple[Status, ...] = ("reproduced", "differs", "data absent", "weights absent", "not run")
TABLES = {
    "quality": "Quality",
    "consistency": "Consistency",
    "ablation": "Ablation",
    "timing": "Time per frame",
}
NOT_MEASURED = Cell("not measured")
# in the name of a method whose weights were trained here, which are not the paper's
RETRAINED = "(retrained"
MEANING = (
    f"reproduced: the paper's value is in the {100 * LEVEL:.0f} % interval of this run, or both "
    "print the same digits; differs: neither; data absent: no run on the paper's data and terms; "
    "weights absent: the method's weights are not included; not run: missing from this run, which "
    "could include it. The views were selected here; the paper does not name its own."
)
HEADS = ("Paper's table", "Method", "Metric", "Paper", "This run", "Status", "Why")
WORDS = (0, 1, 2, 5, 6)  # columns without numbers
# what the paper shows, the part of the page with the same of these runs, the command; as
# docs/paper.md
PAPER_MAP = (
    (
        "Tables 1 and 2, consistency and novel-view synthesis",
        "results",
        "ggvs-eval run OUT --capture DATA --protocol dynerf",
    ),
    ("Table 3, ablation", "", "ggvs-eval sweep ablations OUT --capture DATA --protocol dynerf"),
    (
        "Table 4, time of each stage",
        "timing",
        "ggvs-eval run OUT --capture DATA --protocol dynerf --jobs 1",
    ),
    ("Figure 5, epipolar plane images", "slices", "ggvs-eval figure epi RUN figures/epi"),
    ("Figure 6, slices over time", "slices", "ggvs-eval figure time RUN figures/time"),
    ("Figure 7, qualitative comparison", "compare", "ggvs-eval figure crops RUN figures/crops"),
    ("Figure 8, number of input views", "", "ggvs-eval sweep k OUT --capture DATA"),
    ("Figure 9, limitations", "", "ggvs-eval figure failures RUN figures/failures"),
    ("Figure 12, per-scene methods", "", "ggvs-eval sweep offline OUT --capture DATA"),
)
CSV_HEAD = (
    "table",
    "dataset",
    "method",
    "metric",
    "unit",
    "paper",
    "ours",
    "lo",
    "hi",
    "difference",
    "status",
    "reason",
)
TIMING = "timing"
METHODS_NAMED = 4  # from this number on a line counts methods


@dataclass(frozen=True)
class Reproduction:
    """One published value and its standing here.

    Attributes:
        table: key in `TABLES`.
        dataset: as the paper calls it.
        metric: metric, or stage of the timing.
        unit: of both values; empty if there is none.
        paper: value with the digits that the paper prints.
        ours: what was measured on the same data and terms, or that nothing was.
        status: see `MEANING`.
        reason: why, in words; never empty, and the same for all values that lack the same thing.
        remark: what else is known of this value alone; empty if nothing is.
    """

    table: str
    dataset: str
    method: str
    metric: str
    unit: str
    paper: str
    ours: Cell
    status: Status
    reason: str
    remark: str = ""

    @property
    def why(self) -> str:
        """Reason and remark."""
        return f"{self.reason}; {self.remark}" if self.remark else self.reason


@dataclass(frozen=True)
class PaperMethod:
    """A method of the paper's tables: its name there, its label here, and what the user has to give
    where weights do not ship.
    """

    name: str
    label: str
    weights: str

    def find_label(self, run: MeasuredRun) -> str | None:
        """Return the label under which a run has it: this package's, or that of imported frames of
        either name.
        """
        names = {self.name.lower(), self.label.lower()}
        fitting = (
            label for label in run.labels if {label.lower(), run.name(label).lower()} & names
        )
        return next(fitting, None)


def reproduce(runs: Sequence[MeasuredRun]) -> tuple[Reproduction, ...]:
    """Evaluate every value that the paper publishes.

    Args:
        runs: scored runs, of several protocols if need be; those of one protocol and data set count
            as its scenes.

    Returns:
        One entry per published value, in the order of the paper's tables; none is left out.
    """
    entries = []
    comparable_runs: dict[str, ComparableRuns] = {}
    for value in published_values():
        if not value.table:
            continue
        dataset, key, method = value.scene, value.metric, paper_methods()[value.method]
        if dataset not in comparable_runs:
            comparable_runs[dataset] = find_comparable_runs(dataset, runs)
        comparable = comparable_runs[dataset]
        metric, unit = (TIMING_WORDS[key], "ms") if key in TIMINGS else (key, UNITS.get(key, ""))
        standing: tuple[Cell, Status, str, str]
        if comparable.runs:
            standing = (*_evaluate(comparable, method, key, value.value), "")
        else:
            standing = (
                NOT_MEASURED,
                "data absent",
                comparable.words,
                _remark(comparable.near, method, key),
            )
        entries.append(
            Reproduction(value.table, dataset, value.method, metric, unit, value.value, *standing)
        )
    return tuple(entries)


def _evaluate(
    comparable: ComparableRuns, method: PaperMethod, metric: str, paper: str
) -> tuple[Cell, Status, str]:
    """Look up the measurement of a published value; return its cell, its status and the reason."""
    label = next(filter(None, map(method.find_label, comparable.runs)), None)
    if label is None and method.weights:
        return (
            NOT_MEASURED,
            "weights absent",
            f"wanted {method.weights}, which is not included; pass it by --weights "
            f"{method.label}=FILE",
        )
    if label is None:
        root = comparable.runs[0].folder.root.name
        return (
            NOT_MEASURED,
            "not run",
            f"not rendered in this run; run `ggvs-eval render {root} --methods {method.label}` and "
            f"score again",
        )
    if metric in TIMINGS:
        cell, reason = evaluate_time(comparable.runs, label, metric, float(paper))
        return (NOT_MEASURED, "not run", reason) if cell is None else (cell, "differs", reason)
    return _evaluate_metric(comparable, label, metric, paper)


def _evaluate_metric(
    comparable: ComparableRuns, label: str, metric: str, paper: str
) -> tuple[Cell, Status, str]:
    name = str(comparable.results.table["dataset"].iloc[0])
    marked = comparable.results.set_aside.get(label)
    interval = None if marked else intervals(comparable.results, metric, name).get(label)
    if interval is None or math.isnan(interval.value):
        reason = (
            f"{label} {marked}"
            if marked
            else comparable.results.why_absent(metric, label) or f"{metric} is not in the protocol"
        )
        return NOT_MEASURED, "not run", f"no value: {reason}"
    digits = comparable.runs[0].metrics[metric].decimals
    cell = measured_cell(interval.value, "", interval, digits)
    status, reason = evaluate_value(paper, cell, metric, digits)
    names = {run.name(label) for run in comparable.runs}
    trained = "".join(f"; measured with {name}" for name in sorted(names) if RETRAINED in name)
    return cell, status, f"{reason}; {comparable.words}{trained}"


def evaluate_value(
    paper: str, cell: Cell, metric: str, digits: int | None = None
) -> tuple[Status, str]:
    """Decide whether a measured value reproduces the published one.

    Args:
        digits: after the point, of this run's numbers; None for four significant ones.

    Reading:
        A published value represents all that round to it. It is reproduced where one of those is in
        this run's interval, which covers other frames (and views, from five on); without an
        interval, where the run rounds to the same digits.
    """
    if cell.value is None:
        raise ValueError(f"{metric}: nothing measured")
    decimals = len(paper.partition(".")[2])
    published, half_unit = float(paper), 0.5 * 10.0**-decimals
    note = f" ({cell.note})" if cell.note else ""
    bounds = (
        f"{100 * LEVEL:.0f} % interval {_shown(cell.low, digits)} to "
        f"{_shown(cell.high, digits)}{note}"
    )
    if f"{cell.value:.{decimals}f}" == paper:
        return "reproduced", "the same to the printed digits"
    has_interval = cell.low is not None and cell.high is not None
    if has_interval and cell.low - half_unit <= published <= cell.high + half_unit:  # type: ignore[operator]
        return "reproduced", f"the paper's value is in this run's {bounds}"
    better = "better" if (cell.value > published) == (metric in HIGHER_IS_BETTER) else "worse"
    unit = f" {UNITS[metric]}" if metric in UNITS else ""
    by = format_value(abs(cell.value - published), digits) + unit
    return "differs", f"{better} by {by}; {bounds if has_interval else f'no interval{note}'}"


def _shown(value: float | None, digits: int | None) -> str:
    return "" if value is None else format_value(value, digits)


def _remark(near: MeasuredRun | None, method: PaperMethod, metric: str) -> str:
    """Closest measured value (not comparable), and whether weights are available."""
    remarks = [f"weights of {method.name} are not included either"] if method.weights else []
    if near is not None and metric not in TIMINGS:
        label = method.find_label(near)
        table = near.results.summary()
        named = [
            label_of(*names) == label
            for names in zip(*map(table.index.get_level_values, ("method", "variant")), strict=True)
        ]
        values = table[metric][named].dropna() if metric in table else table.iloc[:0, 0]
        if len(values):
            note = near.metrics.get(metric)
            value = format_value(float(values.iloc[0]), note.decimals if note else None)
            remarks.insert(0, f"{method.name} has {value} there (not comparable)")
    return "; ".join(remarks)


@cache
def paper_methods() -> dict[str, PaperMethod]:
    """Return the methods of the paper's tables by their name there."""
    return {line["name"]: PaperMethod(**line) for line in read_lines("paper_methods")}


@dataclass(frozen=True)
class Block:
    """The values of one of the paper's tables on one data set."""

    title: str
    entries: tuple[Reproduction, ...]

    @property
    def lines(self) -> tuple["Line", ...]:
        """Group the entries: a line per measured value, and one per reason for values that are not
        measured.
        """
        alike: dict[object, list[Reproduction]] = {}
        for number, entry in enumerate(self.entries):
            alike.setdefault(
                number if entry.ours.value is not None else (entry.status, entry.reason), []
            ).append(entry)
        return tuple(_line(entries) for entries in alike.values())


@dataclass(frozen=True)
class Line:
    """Line on one published value, or on several that lack the same: words for each of `HEADS` but
    the first.
    """

    method: str
    metric: str
    paper: str
    ours: Cell
    status: str
    why: str


def _line(entries: Sequence[Reproduction]) -> Line:
    first, *further = entries
    methods = tuple(dict.fromkeys(entry.method for entry in entries))
    method = ", ".join(methods) if len(methods) < METHODS_NAMED else f"{len(methods)} methods"
    if not further:
        metric = f"{first.metric} ({first.unit})" if first.unit else first.metric
        return Line(
            method=method,
            metric=metric,
            paper=first.paper,
            ours=first.ours,
            status=first.status,
            why=first.why,
        )
    metrics = ", ".join(dict.fromkeys(entry.metric for entry in entries))
    return Line(
        method=method,
        metric=metrics,
        paper=f"{len(entries)} values",
        ours=first.ours,
        status=first.status,
        why=first.reason,
    )


def blocks(entries: Sequence[Reproduction]) -> tuple[Block, ...]:
    """Return the values by table and data set, in the order of the paper."""
    by_table: dict[tuple[str, str], list[Reproduction]] = {}
    for entry in entries:
        by_table.setdefault((entry.table, entry.dataset), []).append(entry)
    return tuple(
        Block(f"{TABLES[table]} on {dataset}", tuple(values))
        for (table, dataset), values in by_table.items()
    )


def count_words(entries: Sequence[Reproduction]) -> str:
    """Count the values of each status, in words: ``3 reproduced, 17 data absent``."""
    counts = Counter(entry.status for entry in entries)
    return ", ".join(f"{counts[status]} {status}" for status in STATUSES if counts[status])


def reproduction_markdown(entries: Sequence[Reproduction]) -> str:
    """One table of the paper's values, those grouped that are not measured for one reason.

    What the words mean at the end.
    """
    head = (
        f"# The paper's values and this run's\n\n{len(entries)} published values: "
        f"{count_words(entries)}."
    )
    rows = [_words(block.title, line) for block in blocks(entries) for line in block.lines]
    notes = (MEANING, "All values: reproduction.csv", f"Published values: {SOURCE}", *CAVEATS)
    closing = "\n".join(f"- {escape_markdown(note)}" for note in notes)
    return "\n\n".join([head, markdown_table(HEADS, rows, words=WORDS), closing]) + "\n"


def reproduction_csv(entries: Sequence[Reproduction]) -> str:
    """Return one line per value.

    This run's value, its bounds and its difference unrounded, empty if not measured.
    """
    rows = []
    for entry in entries:
        cell = entry.ours
        difference = None if cell.value is None else cell.value - float(entry.paper)
        numbers = [
            "" if number is None else repr(number)
            for number in (cell.value, cell.low, cell.high, difference)
        ]
        head = (entry.table, entry.dataset, entry.method, entry.metric, entry.unit, entry.paper)
        rows.append([*head, *numbers, entry.status, entry.why])
    return csv_text(CSV_HEAD, rows)


def _words(title: str, line: Line) -> tuple[str, ...]:
    value = f"{line.ours.shown} {line.ours.spread}".strip()
    return tuple(
        map(
            escape_markdown,
            (title, line.method, line.metric, line.paper, value, line.status, line.why),
        )
    )


def paper_tables(entries: Sequence[Reproduction]) -> tuple[Table, ...]:
    """Return one table per table of the paper and data set.

    Returns:
        Grey rows with the paper's values, shaded among themselves, the best bold as the paper
        prints them, each followed by a row of this run, which gives the status where nothing was
        measured.
    """
    return tuple(_table(block.entries) for block in blocks(entries))


def _table(entries: Sequence[Reproduction]) -> Table:
    table, dataset = entries[0].table, entries[0].dataset
    columns = tuple(  # times are not ranked, for each belongs to its machine
        Column(
            entry.metric,
            entry.unit,
            None if entry.table == TIMING else entry.metric in HIGHER_IS_BETTER,
        )
        for entry in {entry.metric: entry for entry in entries}.values()
    )
    methods = dict.fromkeys(entry.method for entry in entries)
    entry_of = {(entry.method, entry.metric): entry for entry in entries}
    paper = {key: entry.paper for key, entry in entry_of.items()}
    published = [
        Row(
            name,
            tuple(published_cell(paper.get((name, column.name))) for column in columns),
            label=name,
        )
        for name in methods
    ]
    rows: list[Row] = []
    best = [_best(published, at, column) for at, column in enumerate(columns)]
    for name, row in zip(methods, rank(columns, published, best), strict=True):
        cells = tuple(_our_cell(entry_of.get((name, column.name))) for column in columns)
        rows += [
            replace(row, name=f"{name} (paper)", kind="published"),
            Row(f"{name}, this run", cells),
        ]
    summary = count_words(entries)
    caption = (
        f"{summary[0].upper()}{summary[1:]}; reproduction.csv has the reasons. Paper: {SOURCE}."
    )
    return Table(
        key=f"reproduction-{table}",
        title=f"{TABLES[table]}, the paper and this run",
        caption=caption,
        columns=columns,
        rows=tuple(rows),
        dataset=dataset,
    )


def _best(rows: Sequence[Row], at: int, column: Column) -> set[str]:
    """Return the methods of the best published value, which has no interval.

    None if all are the same.
    """
    values = {row.label: value for row in rows if (value := row.cells[at].value) is not None}
    top = (max if column.higher_is_better else min)(values.values(), default=None)
    best = {label for label, value in values.items() if value == top}
    return best if len(best) < len(values) else set()


def _our_cell(entry: Reproduction | None) -> Cell:
    if entry is None:
        return Cell("nothing to compare")
    return Cell(entry.status) if entry.ours.value is None else entry.ours


def paper_section(report: Report) -> SectionContent:
    """Return the paper's values next to those of the runs: files, and a sheet of the page if any
    run is on its terms.
    """
    entries = reproduce([*report.runs.values()])
    named = [table for group in report.groups for table in group.tables if _has_paper_rows(table)]
    files = {
        "reproduction.md": reproduction_markdown(entries),
        "reproduction.csv": reproduction_csv(entries),
        "reproduction.tex": to_latex(paper_tables(entries), CAVEATS),
    }
    notes = (f"Grey or italic rows are published values: {SOURCE}", *CAVEATS) if named else ()
    if all(entry.status == "data absent" for entry in entries):
        values = {group.id: {"not_of_paper": len(entries)} for group in report.groups}
        return SectionContent(files=files, notes=notes, values=values)
    sheet = {
        "id": "paper",
        "title": "The paper",
        "comes_first": False,
        "template": "paper",
        "heads": HEADS,
        "details": [_without_empty_rows(table) for table in paper_tables(entries)],
        "blocks": blocks(entries),
        "counts": count_words(entries),
        "meaning": MEANING,
        "n_values": len(entries),
        "map": PAPER_MAP,
        "caveats": CAVEATS,
        "has_rows": bool(named),
    }
    return SectionContent(files=files, notes=notes, sheets=[sheet])


def _has_paper_rows(table: Table) -> bool:
    return any(row.name.endswith(PAPER) for row in table.rows)


def _without_empty_rows(table: Table) -> Table:
    """Return the paper's rows, and those of this run that hold a number."""
    rows = [
        row
        for row in table.rows
        if row.is_grey or any(cell.value is not None for cell in row.cells)
    ]
    return replace(table, rows=tuple(rows))
