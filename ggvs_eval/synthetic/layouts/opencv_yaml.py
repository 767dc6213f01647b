"""Text in the dialect of YAML that OpenCV's FileStorage reads, written so that no digit is lost in any version of OpenCV."""

from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.arrays import Array


def names_entry(key: str, names: Sequence[str]) -> str:
    """A sequence of strings."""
    return "\n".join([f"{key}:", *(f'   - "{name}"' for name in names)])


def number_entry(key: str, value: int) -> str:
    """A whole number."""
    return f"{key}: {value}"


def matrix_entry(key: str, matrix: Array) -> str:
    """A matrix of doubles, every digit of it."""
    data = ", ".join(repr(float(value)) for value in matrix.ravel())
    rows, columns = matrix.shape
    return f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]"


def write_yaml(path: Path, entries: Sequence[str]) -> None:
    """Write a file that ``cv2.FileStorage`` opens."""
    path.write_text("\n".join(["%YAML:1.0", "---", *entries, ""]), encoding="utf-8")
