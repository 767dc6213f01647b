"""Tables as Markdown, CSV, LaTeX, and as an Excel workbook.

The workbook has a sheet per table, numbers as numbers, shaded as elsewhere.
"""

import csv
import importlib.util
import io
import math
import re
import zipfile
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from ggvs_eval.files.atomic import write_bytes
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
LATEX_HEAD = r"""%% \usepackage{booktabs}
%% \usepackage[table]{xcolor}
%% \usepackage{graphicx}
%s\providecommand{\fittowidth}[1]{\sbox0{#1}\ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi}
"""
LONGEST_NAME = 31  # of a sheet, set by Excel
EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest date that a ZIP archive can hold
WRITTEN = re.compile(rb"<dcterms:(created|modified)[^>]*>[^<]*</dcterms:\1>")


def to_markdown(tables: Sequence[Table], notes: Sequence[str] = ()) -> str:
    """GitHub's tables, best values bold, intervals behind them, published rows in italics, notes as
    a closing list.
    """
    parts = []
    for table in tables:
        heads = ["Method", *(escape_markdown(column.head) for column in table.columns)]
        rows = [
            [_markdown_text(row, row.name), *(_markdown_cell(row, cell) for cell in row.cells)]
            for row in table.rows
        ]
        head = f"## {escape_markdown(_title(table))}\n\n{escape_markdown(table.caption)}\n\n"
        note = f"\n\n{escape_markdown(_note(table))}" if _note(table) else ""
        parts.append(head + markdown_table(heads, rows) + note)
    closing = "\n".join(f"- {escape_markdown(note)}" for note in notes)
    return "\n\n".join([*parts, *([closing] if closing else [])]) + "\n"


def markdown_table(
    heads: Sequence[str], rows: Iterable[Sequence[str]], words: Collection[int] = (0,)
) -> str:
    """Return a table in GitHub's Markdown.

    Args:
        rows: cells, one per head, in which nothing is escaped.
        words: columns that are set to the left; the others hold numbers.
    """
    rule = "".join("---|" if at in words else "---:|" for at in range(len(heads)))
    return "\n".join(
        [f"| {' | '.join(heads)} |", f"|{rule}", *(f"| {' | '.join(row)} |" for row in rows)]
    )


def to_csv(groups: Sequence[tuple[Protocol | None, Sequence[Table]]]) -> str:
    """Return one line per cell, values and bounds unrounded.

    ``shown`` is what every other format prints.

    Args:
        groups: a protocol, or None, and the tables of what was measured under it; values of
            different protocols do not compare.
    """
    rows: list[Sequence[object]] = []
    for protocol, tables in groups:
        terms = (protocol.name, protocol.synthesis.k, protocol.sha256) if protocol else ("", "", "")
        for table in tables:
            for row in table.rows:
                for column, cell in zip(table.columns, row.cells, strict=True):
                    head = [
                        table.key,
                        table.dataset,
                        row.name,
                        row.kind,
                        column.name,
                        column.unit,
                        column.higher_is_better,
                    ]
                    rows.append([*head, *_csv_cell(cell), *terms])
    return csv_text(CSV_HEAD, rows)


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    r"""Return the lines of CSV.

    A text that a spreadsheet would compute, as a method called ``=A1``, has an apostrophe before
    it.

    Examples:
        >>> csv_text(["name", "shown"], [["=A1", "-0.5"]])
        "name,shown\n'=A1,-0.5\n"
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        [head, *(map(_plain_cell, row) for row in rows)]
    )
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
    """Value, bounds, what is shown, whether it is best, and what the bounds take as given or why
    something is absent.
    """
    if cell.value is None:
        return ["", "", "", cell.shown, False, cell.note or cell.shown]
    bounds = ["" if bound is None else repr(bound) for bound in (cell.low, cell.high)]
    return [
        repr(cell.value),
        *bounds,
        cell.shown,
        cell.best,
        cell.note if cell.low is not None else cell.hint,
    ]


def to_latex(tables: Sequence[Table], notes: Sequence[str] = ()) -> str:
    """``table`` environments for booktabs and xcolor, shaded as the paper's."""
    comments = "".join(f"% {' '.join(note.split())}\n" for note in notes)
    breaks = ["\\clearpage\n" if at and at % HELD_BACK == 0 else "" for at in range(len(tables))]
    floats = (
        "\n".join([head, *rows, foot]) + "\n" for head, rows, foot in map(latex_parts, tables)
    )
    return (
        _latex_head(tables)
        + comments
        + "\n"
        + "\n".join(map("".join, zip(breaks, floats, strict=True)))
    )


def _latex_head(tables: Sequence[Table]) -> str:
    """Packages, and the meaning of the marks that these tables have."""
    rows = [row for table in tables for row in table.rows]
    cells = [cell for row in rows for cell in row.cells]
    marks = {
        "Blue: the better half of each column, deeper towards its best value.": any(
            cell.shade for cell in cells
        ),
        "Bold: best, or not significantly worse.": any(cell.best for cell in cells),
        "Grey rows: published values, measured by others under other conditions.": any(
            row.kind == "published" for row in rows
        ),
    }
    return LATEX_HEAD % "".join(f"% {words}\n" for words, is_used in marks.items() if is_used)


def escape_latex(text: str) -> str:
    """Return the text in which every character prints as itself."""
    return "".join(LATEX_SPECIAL.get(character, character) for character in " ".join(text.split()))


def _latex_prose(text: str) -> str:
    """Return a caption or note, its code spans as code.

    A backtick would print as a quotation mark.
    """
    parts = re.split(r"`([^`]*)`", text)
    return "".join(
        rf"\texttt{{{escape_latex(part)}}}" if at % 2 else _escape_part(part)
        for at, part in enumerate(parts)
    )


def _escape_part(text: str) -> str:
    """Escape a part of a sentence, which keeps the blanks at its ends."""
    ends = " " if text[:1].isspace() else "", " " if text[-1:].isspace() else ""
    return escape_latex(text).join(ends) if text.strip() else " " * bool(text)


def latex_parts(table: Table) -> tuple[str, list[str], str]:
    """A ``table`` environment: what comes before its rows, each row, and what comes behind them.

    Grey rows follow a rule.
    """
    heads = [escape_latex(column.head) for column in table.columns]
    body: list[str] = []
    for above, row in zip((None, *table.rows), table.rows, strict=False):
        rule = "\\midrule\n" if above is not None and row.is_grey and not above.is_grey else ""
        body.append(
            rule
            + " & ".join(
                [_latex_text(row, row.name), *(_latex_cell(row, cell) for cell in row.cells)]
            )
            + r" \\"
        )
    note = _note(table)
    label = re.sub(r"[^a-z0-9-]+", "-", f"{table.key}-{table.dataset}".lower()).strip("-")
    head = [
        r"\begin{table}",
        rf"\caption{{\label{{table:{label}}}\textbf{{{escape_latex(_title(table))}.}} "
        rf"{_latex_prose(table.caption)}}}",
        r"\centering\small",
        r"\fittowidth{%",
        rf"\begin{{tabular}}{{l{'c' * len(table.columns)}}}",
        r"\toprule",
        " & ".join(["Method", *heads]) + r" \\",
        r"\midrule",
    ]
    foot = [
        r"\bottomrule",
        r"\end{tabular}}",
        *(
            [
                rf"\par\smallskip\begin{{minipage}}{{\linewidth}}\footnotesize "
                rf"{_latex_prose(note)}\end{{minipage}}"
            ]
            if note
            else []
        ),
        r"\end{table}",
    ]
    return "\n".join(head), body, "\n".join(foot)


def copyable(table: Table) -> dict[str, tuple[str, list[str], str]]:
    """Format -> the text before the rows, of each row, and behind them, so that a page can copy the
    rows that it shows.

    As CSV a method is a line: its values unrounded, in front of their bounds where the column has
    intervals.
    """
    names, bounded = (
        ["Method"],
        [
            any(row.cells[at].low is not None for row in table.rows)
            for at in range(len(table.columns))
        ],
    )
    for column, has_bounds in zip(table.columns, bounded, strict=True):
        name = f"{column.name} ({column.unit})" if column.unit else column.name
        names += [name, *([f"{name} low", f"{name} high"] if has_bounds else [])]
    csv_head, lines = csv_text(names, []), []
    for row in table.rows:
        cells: list[object] = [row.name]
        for cell, has_bounds in zip(row.cells, bounded, strict=True):
            cells.append(cell.shown if cell.value is None else repr(cell.value))
            cells += (
                ["" if bound is None else repr(bound) for bound in (cell.low, cell.high)]
                if has_bounds
                else []
            )
        lines.append(csv_text(names, [cells]).removeprefix(csv_head).rstrip("\n"))
    head, rows, foot = latex_parts(table)
    return {
        "latex": (f"{_latex_head([table])}\n{head}", rows, foot),
        "csv": (csv_head.rstrip("\n"), lines, ""),
    }


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
    """Return the text below a table: its note, and the units, which papers leave out of the
    heads.
    """
    by_unit: dict[str, list[str]] = {}
    for column in table.columns:
        by_unit.setdefault(column.unit, []).append(column.name)
    units = "; ".join(f"{', '.join(names)} in {unit}" for unit, names in by_unit.items() if unit)
    return " ".join(filter(None, (*table.notes, table.footnote, f"{units}." if units else "")))


def _markdown_cell(row: Row, cell: Cell) -> str:
    text = f"**{escape_markdown(cell.shown)}**" if cell.best else _markdown_text(row, cell.shown)
    return f"{text} {cell.spread}" if cell.spread else text


def _markdown_text(row: Row, text: str) -> str:
    return f"*{escape_markdown(text)}*" if row.is_grey else escape_markdown(text)


def escape_markdown(text: str) -> str:
    """Return the text in which nothing is markup: no table bar, no emphasis, no tag."""
    escaped = re.sub(r"([\\`*_|\[\]])", r"\\\1", " ".join(text.split()))
    return escaped.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def has_excel() -> bool:
    """Return whether the library that pandas writes workbooks with is installed."""
    return importlib.util.find_spec("openpyxl") is not None


def write_excel(tables: Sequence[Table], values: dict[str, str], out: Path) -> Path:
    """Write a workbook; equal tables give equal bytes.

    Args:
        tables: a sheet each, in which a cell without a value holds the reason.
        values: name of a further sheet -> CSV text with one line per value.
    """
    content = io.BytesIO()
    names: list[str] = []
    with pd.ExcelWriter(content, engine="openpyxl") as writer:
        for table in tables:
            names.append(_sheet_name(f"{table.key} {table.dataset}", names))
            _frame(table).to_excel(writer, sheet_name=names[-1])
            _dress(writer.sheets[names[-1]], table)
        for name, text in values.items():
            pd.read_csv(io.StringIO(text), keep_default_na=False).to_excel(
                writer, sheet_name=_sheet_name(name, names), index=False
            )
        for cell in (
            cell for sheet in writer.sheets.values() for row in sheet.iter_rows() for cell in row
        ):
            if isinstance(cell.value, str):
                cell.data_type = "s"  # a method called ``=A1`` is a name, no formula
    write_bytes(out, _without_dates(content.getvalue()))
    return out


def _frame(table: Table) -> pd.DataFrame:
    heads = [
        f"{column.name} ({column.unit})" if column.unit else column.name for column in table.columns
    ]
    cells = [
        [cell.value if _is_number(cell) else cell.shown for cell in row.cells] for row in table.rows
    ]
    return pd.DataFrame(
        cells,
        index=pd.Index([row.name for row in table.rows], name="Method"),
        columns=heads,
        dtype=object,
    )


def _dress(sheet: Any, table: Table) -> None:
    """Decimals, bold and blue of each cell, grey rows grey; the first row and column hold names."""
    from openpyxl.styles import Font, PatternFill

    for down, row in enumerate(table.rows, start=2):
        for across, cell in enumerate(row.cells, start=2):
            place = sheet.cell(down, across)
            place.font = Font(bold=cell.best, color="FF777777" if row.is_grey else None)
            if _is_number(cell):
                place.number_format = _number_format(cell)
            if cell.shade:
                channel = round(255 * (1.0 - 0.25 * cell.shade))
                place.fill = PatternFill("solid", fgColor=f"FF{channel:02X}{channel:02X}FF")
    sheet.column_dimensions["A"].width = max([10, *(len(row.name) for row in table.rows)])
    for across, cells in enumerate(zip(*(row.cells for row in table.rows), strict=True), start=2):
        # A number that is wider than its column is shown as hashes; words run over or are cut.
        widest = max(
            (len(f"{cell.shown} {cell.spread}") for cell in cells if _is_number(cell)), default=0
        )
        sheet.column_dimensions[sheet.cell(1, across).column_letter].width = max(10, widest + 2)
    sheet.freeze_panes = "B2"


def _is_number(cell: Cell) -> bool:
    return cell.value is not None and math.isfinite(cell.value)


def _number_format(cell: Cell) -> str:
    """Return the decimals, sign and words with which every other format shows the cell, and its
    interval.
    """
    decimals = len(cell.text.partition(".")[2])
    sign = cell.text[0] if cell.text[0] in "+−" else ""
    before = f"{cell.bound} {sign}" if cell.bound else sign
    behind = "".join(f" {words}" for words in (cell.beside, cell.spread) if words)
    digits = "#,##0" if "," in cell.text else "0"
    number = f"{digits}.{'0' * decimals}" if decimals else digits
    pattern = "".join((f'"{before}"' if before else "", number, f'"{behind}"' if behind else ""))
    # in a separate part a negative number has no other sign
    return f"{pattern};{pattern}" if sign == "−" else pattern


def _sheet_name(title: str, names: Sequence[str]) -> str:
    """Return a name that Excel accepts and no other sheet has."""
    clean = re.sub(r"[\[\]:*?/\\']", "-", title).strip()[:LONGEST_NAME]
    count, name = 1, clean
    while name.lower() in {sheet.lower() for sheet in names}:
        count += 1
        name = f"{clean[: LONGEST_NAME - len(str(count)) - 1]} {count}"
    return name


def _without_dates(workbook: bytes) -> bytes:
    """Return the same archive without the time at which it was written."""
    out = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(workbook)) as old,
        zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in sorted(old.namelist()):
            new.writestr(
                zipfile.ZipInfo(name, EPOCH), WRITTEN.sub(b"", old.read(name)), zipfile.ZIP_DEFLATED
            )
    return out.getvalue()
