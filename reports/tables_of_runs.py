"""The tables that a paper prints, from stored results alone: metrics side by side, or a scene per
column and their mean.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from shutil import get_terminal_size
from typing import Literal

from ggvs_eval.errors import ResultsError
from ggvs_eval.merged_results import merge_results
from ggvs_eval.progress import counted
from ggvs_eval.reports.model.measured import MeasuredRun, read_scores
from ggvs_eval.reports.model.table import DASH, SHORT, SHORT_MEANS, Cell, Table, join_tables
from ggvs_eval.reports.run_groups import HASH_DIGITS, runs_by_protocol
from ggvs_eval.reports.tables.report_tables import OWN_TRUTH_MEANS, main_tables
from ggvs_eval.reports.tables.table_formats import to_csv, to_latex, to_markdown
from ggvs_eval.reports.tables.verdict import evaluate_verdict, judge_runs
from ggvs_eval.results import Results, reduced_mark

TableFormat = Literal["markdown", "latex", "csv"]
MEAN = "Mean"


def tables_of_runs(
    roots: Sequence[Path], columns: Sequence[str], to: TableFormat, with_notes: bool = False
) -> str:
    """Return the tables of scored runs of one protocol; neither frames nor the page are touched.

    Args:
        roots: run folders. One scene makes a table with a metric per column, several one table per
            metric, a scene per column.
        columns: metrics, in this order; those of the protocol where none is named.
        to: the format.
        with_notes: also all that a table says of its terms; otherwise a line of them.

    Raises:
        ResultsError: no scored run, runs of several protocols, or a metric that was not measured.
    """
    groups = runs_by_protocol(roots, read_scores)
    if len(groups) > 1:
        called = ", ".join(
            f"{runs[0].protocol.name} ({runs[0].protocol.sha256[:HASH_DIGITS]})" for runs in groups
        )
        raise ResultsError(
            f"wanted runs of one protocol, got {called}; values of different protocols cannot "
            f"share a table"
        )
    (runs,) = groups
    protocol, results = runs[0].protocol, merge_results([run.results for run in runs])
    names = list(dict.fromkeys(columns or protocol.measurement.metrics))
    several = len({run.scene for run in runs}) > 1
    tables = _over_scenes(runs, results, names) if several else [*main_tables(runs, results, names)]
    means = [
        f"{counted(protocol.frames.count, 'frame')} of {counted(len(protocol.views.test), 'view')}"
    ]
    means += filter(None, dict.fromkeys(run.sources_text for run in runs))
    terms = (
        f"Mean over {', '.join(means)}; protocol {protocol.name}, {protocol.sha256[:HASH_DIGITS]}."
    )
    if not with_notes:
        tables = [_in_short(table, terms, names) for table in tables]
    if to == "csv":
        return to_csv([(protocol, tables)])
    return to_latex(tables) if to == "latex" else to_markdown(tables)


def scores_text(root: Path) -> str:
    """Return the scores of a run as the page judges them: who is best, then by label, the best
    first, with intervals and marks.

    Columns that do not fit next to each other follow below.
    """
    run = read_scores(root)
    tables = main_tables([run], run.results, with_grey=False)
    verdict = evaluate_verdict([run], run.results, tables)
    ranked = [contender.label for contender in (*verdict.contenders, *verdict.parts)]
    marks = {
        label: f"{label}{reduced_mark(run.names.get(label, ''))}"
        for label in (*ranked, *run.results.row_labels)
    }
    rows = {(table.key, row.label): row for table in tables for row in table.rows}
    columns = []
    for table in tables:
        for at, column in enumerate(table.columns):
            cells = [rows[table.key, label].cells[at] for label in marks]
            if any(cell.value is not None for cell in cells):  # `not_computed` says why
                columns.append([column.name, *map(_cell_text, cells)])
    names = ["", *marks.values()]
    width = get_terminal_size((130, 40)).columns - max(map(len, names))
    lines = [f"{verdict.headline}. {verdict.margin}".strip()]
    while columns:
        widths = list(accumulate(2 + max(map(len, column)) for column in columns))
        count = max(1, sum(end <= width for end in widths))
        block, columns = columns[:count], columns[count:]
        lines += _aligned([names, *block])
    text = "\n".join(lines)
    legends = {"*": "*: best, or not significantly worse", SHORT: SHORT_MEANS}
    return "\n".join([text, *(words for mark, words in legends.items() if mark in text)])


def _cell_text(cell: Cell) -> str:
    """Return a value to four decimals, its interval and its mark."""
    if cell.value is None:
        return DASH
    return f"{cell.value:.4f}{f' {cell.spread}' if cell.spread else ''}{'*' if cell.best else ''}"


def _aligned(columns: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of columns of text, the first one the names of the lines."""
    padded = []
    for at, column in enumerate(columns):
        width = max(map(len, column))
        padded.append([text.ljust(width) if at == 0 else f"  {text:<{width}}" for text in column])
    return ["".join(line).rstrip() for line in zip(*padded, strict=True)]


def _in_short(table: Table, terms: str, metrics: Sequence[str]) -> Table:
    """With one line of terms, and below it what changes the reading of a number: its frames and
    views, a fault, a short clip.
    """
    _, _, marks = table.caption.partition(". ")
    subjects = (*metrics, *(row.name for row in table.rows if not row.is_grey))
    notes = [
        note
        for note in table.notes
        if note.startswith(tuple(f"{subject} " for subject in subjects))
    ]
    notes += [note for note in table.notes if note == OWN_TRUTH_MEANS]
    notes += [SHORT_MEANS] if any(cell.is_short for row in table.rows for cell in row.cells) else []
    return replace(table, caption=f"{terms} {marks}".strip(), notes=tuple(notes))


def _over_scenes(
    runs: Sequence[MeasuredRun], results: Results, metrics: Sequence[str]
) -> list[Table]:
    """Return per metric a table with a column per scene and one of their mean, each judged
    alone.
    """
    parts = {run.scene: ([run], run.results) for run in runs} | {MEAN: (runs, results)}
    standings = {name: judge_runs(*part) for name, part in parts.items()}
    tables = []
    for metric in metrics:
        columns = []
        for name, part in parts.items():
            table = main_tables(part[0], part[1], [metric], standings=standings[name])[0]
            unit = table.columns[0].unit
            column = replace(table.columns[0], name=name, unit="")
            columns.append(replace(table, key=name, dataset="", columns=(column,)))
        (joined,) = join_tables(columns, [*parts])
        tables.append(
            replace(
                joined, key=metric, title=f"{metric}, {unit}" if unit else metric, judgements={}
            )
        )
    return tables
