"""Tables with the times of frames: text, JSON and arrays."""

import json
import re
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.files.array_file import map_array
from ggvs_eval.files.names import clock_s, over_midnight
from ggvs_eval.files.plain import read_plain_text

TABLES = (".csv", ".tsv", ".txt", ".json", ".npy")
TIME = re.compile(r"time|stamp|pts", re.I)  # columns
Rows = list[list[str]]


def read_rows(file: Path) -> Rows:
    """Return the cells of a table, those of its head first; empty if it cannot be read.

    Reading:
        JSON is a list of times, a list of tables of one row, or a table of lists; an array has a
        row or a column per frame, whichever are more.
    """
    try:
        if file.suffix == ".npy":
            values = np.atleast_2d(map_array(file))
            return [
                [*map(repr, row)]
                for row in (values.T if values.shape[0] < values.shape[1] else values).tolist()
            ]
        text = read_plain_text(file)
        if file.suffix == ".json":
            return _json_rows(json.loads(text))
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return []
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    parting = r"[,;\t]" if lines and re.search(r"[,;\t]", lines[0]) else r"\s+"
    rows = [[cell.strip(' "#') for cell in re.split(parting, line)] for line in lines]
    return [row for row in rows if len(row) == len(rows[0])]


def _json_rows(table: Any) -> Rows:
    if isinstance(table, dict):
        columns = zip_longest(*table.values(), fillvalue="")
        return [[*table], *([*map(str, row)] for row in columns)]
    if table and isinstance(table[0], dict):
        return [[*table[0]], *([str(row.get(key, "")) for key in table[0]] for row in table)]
    return [[str(value)] for value in table]


def times_in(rows: Rows) -> Array:
    """Return the column of times in the rows of a camera, (T,); empty if there is none."""
    head, *body = rows or [[]]
    body = rows if all(number_in(cell) is not None for cell in head) else body
    ascending: list[tuple[bool, int, Array]] = []
    for title, cells in zip(head, zip(*body, strict=True), strict=False):
        numbers = [number for cell in cells if (number := number_in(cell)) is not None]
        values = np.array(over_midnight(numbers))
        if 1 < len(values) == len(cells) and (np.diff(values) > 0).all():
            ascending.append((bool(TIME.search(title)), len(ascending), values))
    return max(ascending, key=lambda column: column[:2])[2] if ascending else np.empty(0)


def number_in(cell: str) -> float | None:
    """Return a finite number, or a time of day in seconds."""
    try:
        number = float(cell)
    except ValueError:
        time_s = clock_s(cell)
        return None if time_s is None else float(time_s)
    return number if np.isfinite(number) else None
