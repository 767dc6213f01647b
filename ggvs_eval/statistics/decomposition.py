"""Two-way decomposition of a metric: its views x frames matrix as grand mean + view effect + time
effect + rest.

The matrix holds the values of one metric, method and scene, cut from the tidy table of results.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results, label_of

if TYPE_CHECKING:
    import pandas as pd

NAMED = 4  # missing cells that a message names before it counts the rest


@dataclass(frozen=True)
class TwoWay:
    """A views x frames matrix taken apart: ``values[v, t] = mean + view[v] + time[t] + rest[v,
    t]``, exactly.

    The four parts are orthogonal, so their sums of squares add up:
    ``sum(values ** 2) = V T mean ** 2 + ss_view + ss_time + ss_rest``.

    SDT and SDV are margins of the same parts. With s_v the standard deviation of view v over its
    frames and u_t that of frame t over the views, both with divisor n - ddof:

    - mean of s_v ** 2 over the views  = (ss_time + ss_rest) / (V (T - ddof))
    - mean of u_t ** 2 over the frames = (ss_view + ss_rest) / (T (V - ddof))
    - SDT ** 2 = (mean of s_v) ** 2 is the first less var(s_v), SDV ** 2 the second less var(u_t),
      the outer variance with divisor n: the mean of squares is the square of the mean plus the
      variance.

    So a bias moves neither, SDT is blind to the view effect, SDV to the time effect, and the rest
    is in both.

    Attributes:
        mean: grand mean, the bias of an error; unit of the metric.
        view: (V,), sums to 0.
        time: (T,), sums to 0.
        residual: (V, T), the interaction and noise; each row and each column sums to 0.
    """

    mean: float
    view: Array
    time: Array
    residual: Array
    views: tuple[str, ...]
    frames: tuple[int, ...]

    @property
    def ss_view(self) -> float:
        """Sum over all cells of the squared view effect."""
        return float(len(self.time) * np.square(self.view).sum())

    @property
    def ss_time(self) -> float:
        """Sum over all cells of the squared time effect."""
        return float(len(self.view) * np.square(self.time).sum())

    @property
    def ss_rest(self) -> float:
        """Sum over all cells of the squared rest."""
        return float(np.square(self.residual).sum())

    def shares(self) -> dict[str, float]:
        """Part of the variance about the grand mean that is due to ``view``, ``time`` and ``rest``.

        0 if nothing varies.
        """
        squares = {"view": self.ss_view, "time": self.ss_time, "rest": self.ss_rest}
        total = sum(squares.values())
        return {name: square / total if total else 0.0 for name, square in squares.items()}

    def sdt(self, ddof: int = 1) -> float:
        """Return the mean over the views of the standard deviation over time, from the
        parts alone.
        """
        _check_count(self.residual.shape[1], ddof, "frames")
        return float((self.time + self.residual).std(axis=1, ddof=ddof).mean())

    def sdv(self, ddof: int = 1) -> float:
        """Return the mean over the frames of the standard deviation over views, from the parts
        alone.
        """
        _check_count(self.residual.shape[0], ddof, "views")
        return float((self.view[:, None] + self.residual).std(axis=0, ddof=ddof).mean())


def decompose(
    values: ArrayLike, views: tuple[str, ...] = (), frames: tuple[int, ...] = ()
) -> TwoWay:
    """Take a full matrix apart.

    Args:
        values: (V, T), finite, e.g. the L1 of each view and frame.
        views: names of its rows; numbers where not given.
        frames: numbers of its columns; from 0 where not given.
    """
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.ndim != 2 or matrix.size == 0:
        raise ResultsError(
            f"a decomposition wants values of shape (views, frames), got {matrix.shape}; give one "
            f"row per view"
        )
    if not np.isfinite(matrix).all():
        view, frame = np.argwhere(~np.isfinite(matrix))[0]
        raise ResultsError(
            f"a decomposition wants every cell, row {view} column {frame} is "
            f"{matrix[view, frame]}; provide it"
        )
    mean = float(matrix.mean())
    view, time = matrix.mean(axis=1) - mean, matrix.mean(axis=0) - mean
    residual = matrix - mean - view[:, None] - time
    rows, columns = views or tuple(map(str, range(len(view)))), frames or tuple(range(len(time)))
    return TwoWay(mean=mean, view=view, time=time, residual=residual, views=rows, frames=columns)


def decompose_metric(
    results: Results,
    metric: str,
    scene: str,
    method: str,
    variant: str = "",
    dataset: str | None = None,
) -> TwoWay:
    """`decompose` the values of one metric, method and scene.

    Raises:
        ResultsError: no such values, a missing cell (named), a value that is not finite, or values
            of the whole rig or sequence.
    """
    panel = read_panel(results, metric, scene, method, variant, dataset)
    views = tuple(view for view in panel.views if view is not None)
    if not views or panel.frames[0] < 0:
        raise ResultsError(
            f"{metric} has no value for each view and frame; decompose another, such as L1"
        )
    return decompose(panel.values, views, panel.frames)


def _check_count(count: int, ddof: int, subject: str) -> None:
    if count <= ddof:
        raise ResultsError(
            f"a deviation over {subject} with ddof={ddof} needs at least {ddof + 1}, got {count}"
        )


@dataclass(frozen=True)
class Panel:
    """One metric of one method and scene.

    Attributes:
        views: names in alphabetical order; the only one is None if a value belongs to the whole
            rig.
        frames: frame numbers, ascending; the only one is -1 if a value belongs to the whole
            sequence.
        values: (V, T), finite.
    """

    views: tuple[str | None, ...]
    frames: tuple[int, ...]
    values: Array


def read_panel(
    results: Results,
    metric: str,
    scene: str,
    method: str,
    variant: str = "",
    dataset: str | None = None,
) -> Panel:
    """Cut one panel from the table.

    Args:
        variant: its variant, empty for the plain method.
        dataset: None if the results know one only.

    Raises:
        ResultsError: no such values, a missing cell, or a value that is not finite.
    """
    table = results.table
    selection = {"metric": metric, "scene": scene, "method": method, "variant": variant}
    selection |= {} if dataset is None else {"dataset": dataset}
    for column, value in selection.items():
        table = table[table[column] == value]
    if table["dataset"].nunique() > 1:
        raise ResultsError(
            f"{metric}: values of {' and '.join(sorted(table['dataset'].unique()))}; name one data "
            f"set"
        )
    return make_panel(table, f"{metric} of {label_of(method, variant)} in {scene}")


def make_panel(cells: "pd.DataFrame", subject: str) -> Panel:
    """Arrange the rows of one metric, method and scene as views x frames.

    The order of the rows does not matter.

    Args:
        cells: rows of the tidy table with ``view``, ``frame`` and ``value``.

    Raises:
        ResultsError: no rows, two values for one cell, a missing cell, or a value that is not
            finite.
    """
    if cells.empty:
        raise ResultsError(f"{subject}: no values in the results; score it")
    views, rows = np.unique(
        cells["view"].to_numpy(dtype=object, na_value="").astype(str), return_inverse=True
    )
    frames, columns = np.unique(cells["frame"].to_numpy(), return_inverse=True)
    counts = np.zeros((len(views), len(frames)), int)
    np.add.at(counts, (rows, columns), 1)
    if counts.max() > 1:
        raise ResultsError(
            f"{subject}: two values for one view and frame; score again into a new folder"
        )
    values = np.full(counts.shape, np.nan)
    values[rows, columns] = cells["value"].to_numpy(dtype=np.float64)
    names = tuple(str(view) or None for view in views)  # None of the whole rig
    panel = Panel(names, tuple(int(frame) for frame in frames), values)
    _check_cells(panel, counts > 0, subject)
    return panel


def _check_cells(panel: Panel, present: NDArray[np.bool_], subject: str) -> None:
    """Refuse a panel with holes, naming the first ones."""
    holes = ~np.isfinite(panel.values)
    if not holes.any():
        return
    bad = [(row, column) for row, column in np.argwhere(holes)]
    missing = [cell for cell in bad if not present[cell]]
    cells = (missing or bad)[:NAMED]
    named = ", ".join(
        f"{panel.views[row] or 'the rig'} frame {panel.frames[column]}" for row, column in cells
    )
    more = f" and {len(missing or bad) - NAMED} more" if len(missing or bad) > NAMED else ""
    if missing:
        raise ResultsError(
            f"{subject}: wanted a value for each view and frame, {named}{more} missing; score all "
            f"frames of each"
        )
    raise ResultsError(
        f"{subject}: wanted finite values, {named}{more} not finite; omit this metric"
    )
