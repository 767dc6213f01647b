"""Tables beside a capture that say when each frame of each camera was taken."""

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.datasets.media import match_cameras
from ggvs_eval.files.listing import list_files_below
from ggvs_eval.files.names import clock_s, listed
from ggvs_eval.files.plain import read_plain_text

TIMES = re.compile(r"time|stamp|sync", re.I)
TABLES, DEEPEST = (".csv", ".tsv", ".txt"), 2
TIME, CAMERA = re.compile(r"time|stamp|pts", re.I), re.compile(r"cam|device|view|port|serial", re.I)  # columns
Rows = list[list[str]]


class FrameTimes(NamedTuple):
    """When the frames of cameras were taken.

    Attributes:
        times: of each camera in ascending order, (T,), in any unit; none where no table has those of all.
        files: that have them, relative to the capture.
        notes: why a table with times is not used.
    """

    times: Mapping[str, Array]
    files: Sequence[str] = ()
    notes: Sequence[str] = ()


def read_times(path: Path, counts: Mapping[str, int]) -> FrameTimes:
    """Return the times of a table of all cameras, or of one table per camera, up to two levels below a capture.

    Args:
        counts: frames of each camera.

    Reading:
        A table of all cameras has a column that names them and a row per frame, or a column per camera. Times ascend; they are
        the column that is called so, else the last one that ascends.
    """
    if min(counts.values()) < 2:
        return FrameTimes({})
    names = [str(file.relative_to(path)) for file in list_files_below(path, TABLES, DEEPEST)]
    tables = {name: _rows(path / name) for name in names if TIMES.search(name)}
    of_cameras = match_cameras(counts, tables).names
    candidates = [([name], _of_all(rows, counts)) for name, rows in tables.items()]
    candidates.append(([*of_cameras.values()], {camera: _times(tables[name]) for camera, name in of_cameras.items()}))
    notes = []
    for files, times in candidates:
        odd = [f"{camera} {len(row)} of {counts[camera]} frames" for camera, row in times.items() if len(row) != counts[camera]]
        if len(times) == len(counts) and not odd:
            return FrameTimes({camera: times[camera] for camera in counts}, files)
        notes += [f"times in {listed(files)} are not used: {listed(odd)}"] if odd and all(map(len, times.values())) else []
    return FrameTimes({}, notes=notes)


def _rows(file: Path) -> Rows:
    """Return the cells of a table, those of its head first; empty if it cannot be read."""
    try:
        lines = read_plain_text(file).splitlines()
    except (OSError, ValueError):
        return []
    parting = r"[,;\t]" if re.search(r"[,;\t]", lines[0]) else r"\s+"
    rows = [[cell.strip(' "#') for cell in re.split(parting, line.strip())] for line in lines if line.strip()]
    return [row for row in rows if len(row) == len(rows[0])]


def _of_all(rows: Rows, cameras: Collection[str]) -> dict[str, Array]:
    """Return the times of each camera in a table of all; none if it is another table."""
    head, *body = rows or [[]]
    of_camera = match_cameras(cameras, head).names
    if len(of_camera) == len(cameras):
        columns = {camera: head.index(name) for camera, name in of_camera.items()}
        return {camera: _times([[row[index]] for row in body if row[index]]) for camera, index in columns.items()}
    if any(_value(cell) is not None for cell in head):
        head, body = [""] * len(head), rows
    for index in sorted(range(len(head)), key=lambda index: not CAMERA.search(head[index])):
        of_camera = match_cameras(cameras, {row[index] for row in body}).names
        if len(of_camera) == len(cameras):
            return {camera: _times([head, *(row for row in body if row[index] == name)]) for camera, name in of_camera.items()}
    return {}


def _times(rows: Rows) -> Array:
    """Return the column of times in the rows of a camera, (T,); empty if there is none."""
    body = rows if all(_value(cell) is not None for cell in rows[0]) else rows[1:]
    ascending: list[tuple[bool, int, Array]] = []
    for title, cells in zip(rows[0], zip(*body, strict=True), strict=False):
        values = np.array([np.nan if (value := _value(cell)) is None else value for cell in cells])
        if len(values) > 1 and (np.diff(values) > 0).all():
            ascending.append((bool(TIME.search(title)), len(ascending), values))
    return max(ascending, key=lambda column: column[:2])[2] if ascending else np.empty(0)


def _value(cell: str) -> float | None:
    """Return a number, or a time of day in seconds."""
    try:
        return float(cell)
    except ValueError:
        time_s = clock_s(cell)
        return None if time_s is None else float(time_s)
