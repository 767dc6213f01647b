"""Tables as an Excel workbook: a sheet per table, numbers as numbers, shaded as elsewhere."""

import importlib.util
import io
import math
import re
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.reports.model.table import Cell, Table

LONGEST_NAME = 31  # of a sheet, set by Excel
EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest date that a ZIP archive can hold
WRITTEN = re.compile(rb"<dcterms:(created|modified)[^>]*>[^<]*</dcterms:\1>")


def has_excel() -> bool:
    """Tell whether the library that pandas writes workbooks with is installed."""
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
        for sheet in writer.sheets.values():
            _take_text_literally(sheet)
    write_bytes(out, _without_dates(content.getvalue()))
    return out


def _frame(table: Table) -> pd.DataFrame:
    heads = [f"{column.name} ({column.unit})" if column.unit else column.name for column in table.columns]
    cells = [[cell.value if _is_number(cell) else cell.shown for cell in row.cells] for row in table.rows]
    return pd.DataFrame(cells, index=pd.Index([row.name for row in table.rows], name="Method"), columns=heads, dtype=object)


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
        widest = max((len(f"{cell.shown} {cell.spread}") for cell in cells if _is_number(cell)), default=0)
        sheet.column_dimensions[sheet.cell(1, across).column_letter].width = max(10, widest + 2)
    sheet.freeze_panes = "B2"


def _is_number(cell: Cell) -> bool:
    return cell.value is not None and math.isfinite(cell.value)


def _number_format(cell: Cell) -> str:
    """The decimals, sign and words with which every other format shows the cell, and its interval."""
    decimals = len(cell.text.partition(".")[2])
    sign = cell.text[0] if cell.text[0] in "+−" else ""
    before = f"{cell.bound} {sign}" if cell.bound else sign
    behind = "".join(f" {words}" for words in (cell.beside, cell.spread) if words)
    whole = "#,##0" if "," in cell.text else "0"
    number = f"{whole}.{'0' * decimals}" if decimals else whole
    shown = "".join((f'"{before}"' if before else "", number, f'"{behind}"' if behind else ""))
    return f"{shown};{shown}" if sign == "−" else shown  # in a part of its own a negative number has no other sign


def _sheet_name(title: str, taken: Sequence[str]) -> str:
    """A name that Excel accepts and no other sheet has."""
    clean = re.sub(r"[\[\]:*?/\\']", "-", title).strip()[:LONGEST_NAME]
    count, name = 1, clean
    while name.lower() in {other.lower() for other in taken}:
        count += 1
        name = f"{clean[: LONGEST_NAME - len(str(count)) - 1]} {count}"
    return name


def _take_text_literally(sheet: Any) -> None:
    """A method called ``=A1`` is a name, no formula."""
    for row in sheet.iter_rows():
        for cell in row:
            if isinstance(cell.value, str):
                cell.data_type = "s"


def _without_dates(workbook: bytes) -> bytes:
    """The same archive without the time at which it was written."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(workbook)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for name in sorted(old.namelist()):
            new.writestr(zipfile.ZipInfo(name, EPOCH), WRITTEN.sub(b"", old.read(name)), zipfile.ZIP_DEFLATED)
    return out.getvalue()
