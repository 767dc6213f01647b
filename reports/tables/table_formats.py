"""Tables as Markdown, CSV and LaTeX."""

import csv
import io
import re
from collections.abc import Collection, Iterable, Sequence

from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.model.table import Cell, Row, Table

LATEX_SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "×": r"$\times$",
    "±": r"$\pm$",
    "†": r"$\dagger$",
    "−": "$-$",
    "∞": r"$\infty$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
}
CSV_HEAD = (
    *("table", "dataset", "method", "kind", "column", "unit", "higher_is_better"),
    *("value", "lo", "hi", "shown", "best", "note"),
    *("protocol", "k", "protocol_sha256"),
)
HELD_BACK = 40  # tables; LaTeX keeps those that no text follows, and stops at the 53rd
LATEX_HEAD = r"""% \usepackage{booktabs}
% \usepackage[table]{xcolor}
% \usepackage{graphicx}
% Blue: the better half of each column, proportional to its standing, on the scale of the paper's tables.
% Bold: the best, and what is not significantly worse.
% Grey: published values, measured by others on other terms.
\providecommand{\fittowidth}[1]{\sbox0{#1}\ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi}
"""


def to_markdown(tables: Sequence[Table], notes: Sequence[str] = ()) -> str:
    """GitHub's tables, best values bold, intervals behind them, published rows in italics, notes as a closing list."""
    parts = []
    for table in tables:
        heads = ["Method", *(escape_markdown(column.head) for column in table.columns)]
        rows = [[_markdown_text(row, row.name), *(_markdown_cell(row, cell) for cell in row.cells)] for row in table.rows]
        head = f"## {escape_markdown(_title(table))}\n\n{escape_markdown(table.caption)}\n\n"
        note = f"\n\n{escape_markdown(_note(table))}" if _note(table) else ""
        parts.append(head + markdown_table(heads, rows) + note)
    closing = "\n".join(f"- {escape_markdown(note)}" for note in notes)
    return "\n\n".join([*parts, *([closing] if closing else [])]) + "\n"


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]], words: Collection[int] = (0,)) -> str:
    """A table in GitHub's Markdown.

    Args:
        rows: cells, one per head, in which nothing is escaped.
        words: columns that are set to the left; the others hold numbers.
    """
    rule = "".join("---|" if at in words else "---:|" for at in range(len(heads)))
    return "\n".join([f"| {' | '.join(heads)} |", f"|{rule}", *(f"| {' | '.join(row)} |" for row in rows)])


def to_csv(groups: Sequence[tuple[Protocol | None, Sequence[Table]]]) -> str:
    """One line per cell, values and bounds unrounded; ``shown`` is what every other format prints.

    Args:
        groups: a protocol, or None, and the tables of what was measured under it; values of different protocols do not compare.
    """
    rows: list[Sequence[object]] = []
    for protocol, tables in groups:
        terms = (protocol.name, protocol.synthesis.k, protocol.sha256) if protocol else ("", "", "")
        for table in tables:
            for row in table.rows:
                for column, cell in zip(table.columns, row.cells, strict=True):
                    head = [table.key, table.dataset, row.name, row.kind, column.name, column.unit, column.higher_is_better]
                    rows.append([*head, *_csv_cell(cell), *terms])
    return csv_text(CSV_HEAD, rows)


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    r"""Lines of CSV; a text that a spreadsheet would compute, as a method called ``=A1``, has an apostrophe before it.

    Examples:
        >>> csv_text(["name", "shown"], [["=A1", "-0.5"]])
        "name,shown\n'=A1,-0.5\n"
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *(map(_plain_cell, row) for row in rows)])
    return text.getvalue()


def _plain_cell(cell: object) -> object:
    if not isinstance(cell, str) or not cell.startswith(("=", "+", "-", "@", "\t", "\r")):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


def _csv_cell(cell: Cell) -> list[object]:
    """Value, bounds, what is shown, whether it is best, and what the bounds take as given or why something is absent."""
    if cell.value is None:
        return ["", "", "", cell.shown, False, cell.note or cell.shown]
    bounds = ["" if bound is None else repr(bound) for bound in (cell.low, cell.high)]
    return [repr(cell.value), *bounds, cell.shown, cell.best, cell.note if cell.low is not None else cell.hint]


def to_latex(tables: Sequence[Table], notes: Sequence[str] = ()) -> str:
    """``table`` environments for booktabs and xcolor, shaded as the paper's."""
    comments = "".join(f"% {' '.join(note.split())}\n" for note in notes)
    breaks = ["\\clearpage\n" if at and at % HELD_BACK == 0 else "" for at in range(len(tables))]
    return LATEX_HEAD + comments + "\n" + "\n".join(map("".join, zip(breaks, map(_latex_table, tables), strict=True)))


def escape_latex(text: str) -> str:
    """Text in which every character prints as itself."""
    return "".join(LATEX_SPECIAL.get(character, character) for character in " ".join(text.split()))


def _latex_table(table: Table) -> str:
    heads = [escape_latex(column.head) for column in table.columns]
    body: list[str] = []
    for above, row in zip((None, *table.rows), table.rows, strict=False):
        if above is not None and row.is_grey and not above.is_grey:
            body.append(r"\midrule")
        body.append(" & ".join([_latex_text(row, row.name), *(_latex_cell(row, cell) for cell in row.cells)]) + r" \\")
    note = _note(table)
    label = re.sub(r"[^a-z0-9-]+", "-", f"{table.key}-{table.dataset}".lower()).strip("-")
    lines = [
        r"\begin{table}",
        rf"\caption{{\label{{table:{label}}}\textbf{{{escape_latex(_title(table))}.}} {escape_latex(table.caption)}}}",
        r"\centering\small",
        r"\fittowidth{%",
        rf"\begin{{tabular}}{{l{'c' * len(table.columns)}}}",
        r"\toprule",
        " & ".join(["Method", *heads]) + r" \\",
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}}",
        *([rf"\par\smallskip\begin{{minipage}}{{\linewidth}}\footnotesize {escape_latex(note)}\end{{minipage}}"] if note else []),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _latex_cell(row: Row, cell: Cell) -> str:
    text = _latex_text(row, cell.shown)
    text = rf"\textbf{{{text}}}" if cell.best else text
    spread = escape_latex(cell.spread)
    spread = rf"\textcolor{{gray}}{{{spread}}}" if cell.is_short else spread
    text += rf" {{\scriptsize {spread}}}" if cell.spread else ""
    if not cell.shade:
        return text
    channel = 1.0 - 0.25 * cell.shade
    return rf"\cellcolor[rgb]{{{channel:.3f}, {channel:.3f}, 1}}{text}"


def _latex_text(row: Row, text: str) -> str:
    return rf"\textcolor{{gray}}{{{escape_latex(text)}}}" if row.is_grey else escape_latex(text)


def _title(table: Table) -> str:
    return f"{table.title} ({table.dataset})" if table.dataset else table.title


def _note(table: Table) -> str:
    """What stands below a table: its note, and the units, which the field leaves out of the heads."""
    by_unit: dict[str, list[str]] = {}
    for column in table.columns:
        by_unit.setdefault(column.unit, []).append(column.name)
    units = "; ".join(f"{', '.join(names)} in {unit}" for unit, names in by_unit.items() if unit)
    return " ".join(filter(None, (*table.notes, f"{units}." if units else "")))


def _markdown_cell(row: Row, cell: Cell) -> str:
    text = f"**{escape_markdown(cell.shown)}**" if cell.best else _markdown_text(row, cell.shown)
    return f"{text} {cell.spread}" if cell.spread else text


def _markdown_text(row: Row, text: str) -> str:
    return f"*{escape_markdown(text)}*" if row.is_grey else escape_markdown(text)


def escape_markdown(text: str) -> str:
    """Text in which nothing is markup: no table bar, no emphasis, no tag."""
    escaped = re.sub(r"([\\`*_|\[\]])", r"\\\1", " ".join(text.split()))
    return escaped.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
