"""The values of one metric, method and scene as a matrix of views and frames, cut from the tidy table of results."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results, label_of

if TYPE_CHECKING:
    import pandas as pd

NAMED = 4  # missing cells that a message names before it counts the rest


@dataclass(frozen=True)
class Panel:
    """One metric of one method and scene.

    Attributes:
        views: names in alphabetical order; the only one is None where a value belongs to the whole rig.
        frames: frame numbers, rising; the only one is -1 where a value belongs to the whole sequence.
        values: (V, T), finite.
    """

    views: tuple[str | None, ...]
    frames: tuple[int, ...]
    values: Array


def read_panel(results: Results, metric: str, scene: str, method: str, variant: str = "", dataset: str | None = None) -> Panel:
    """Cut one panel from the table.

    Args:
        variant: its variant, empty for the plain method.
        dataset: None where the results know one only.

    Raises:
        ResultsError: no such values, a missing cell, or a value that is not finite.
    """
    table = results.table
    selection = {"metric": metric, "scene": scene, "method": method, "variant": variant}
    selection |= {} if dataset is None else {"dataset": dataset}
    for column, value in selection.items():
        table = table[table[column] == value]
    if table["dataset"].nunique() > 1:
        raise ResultsError(f"{metric}: values of {' and '.join(sorted(table['dataset'].unique()))}; say which data set")
    return make_panel(table, f"{metric} of {label_of(method, variant)} in {scene}")


def make_panel(cells: "pd.DataFrame", what: str) -> Panel:
    """Arrange the rows of one metric, method and scene as views x frames; the order of the rows does not matter.

    Args:
        cells: rows of the tidy table with ``view``, ``frame`` and ``value``.

    Raises:
        ResultsError: no rows, two values for one cell, a missing cell, or a value that is not finite.
    """
    if cells.empty:
        raise ResultsError(f"{what}: no values in the results; score it")
    views = cells["view"].astype(object).where(cells["view"].notna(), "")  # one key for "the whole rig"
    cells = cells.assign(view=views)
    if cells.duplicated(["view", "frame"]).any():
        raise ResultsError(f"{what}: two values for one view and frame; score again into an empty folder")
    matrix = cells.pivot(index="view", columns="frame", values="value").sort_index().sort_index(axis=1)
    _check_cells(matrix, {(view, frame) for view, frame in zip(views, cells["frame"], strict=True)}, what)
    names = tuple(None if view == "" else str(view) for view in matrix.index)
    return Panel(names, tuple(int(frame) for frame in matrix.columns), matrix.to_numpy(dtype=np.float64))


def _check_cells(matrix: "pd.DataFrame", present: set[tuple[str, int]], what: str) -> None:
    """Refuse a matrix with holes, naming the first ones."""
    holes = ~np.isfinite(matrix.to_numpy(dtype=np.float64))
    if not holes.any():
        return
    bad = [(matrix.index[row], matrix.columns[column]) for row, column in np.argwhere(holes)]
    missing = [cell for cell in bad if cell not in present]
    named = ", ".join(f"{view or 'the rig'} frame {frame}" for view, frame in (missing or bad)[:NAMED])
    more = f" and {len(missing or bad) - NAMED} more" if len(missing or bad) > NAMED else ""
    if missing:
        raise ResultsError(f"{what}: wanted a value for each view and frame, {named}{more} missing; score all frames of each")
    raise ResultsError(f"{what}: wanted finite values, {named}{more} not finite; leave this metric out")
