"""Two-way decomposition of a metric: its views x frames matrix as grand mean + view effect + time effect + rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results
from ggvs_eval.statistics.panels import read_panel


@dataclass(frozen=True)
class TwoWay:
    """A views x frames matrix taken apart: ``values[v, t] = mean + view[v] + time[t] + rest[v, t]``, exactly.

    The four parts are orthogonal, so their sums of squares add up:
    ``sum(values ** 2) = V T mean ** 2 + ss_view + ss_time + ss_rest``.

    SDT and SDV are margins of the same parts. With s_v the standard deviation of view v over its frames and u_t that of
    frame t over the views, both with divisor n - ddof:

    - mean of s_v ** 2 over the views  = (ss_time + ss_rest) / (V (T - ddof)), `variance_over_time`
    - mean of u_t ** 2 over the frames = (ss_view + ss_rest) / (T (V - ddof)), `variance_over_views`
    - SDT ** 2 = (mean of s_v) ** 2 = variance_over_time - var(s_v), SDV ** 2 = variance_over_views - var(u_t), the outer
      variance with divisor n: the mean of squares is the square of the mean plus the variance.

    So a bias moves neither, SDT is blind to the view effect, SDV to the time effect, and the rest is in both.

    Attributes:
        mean: grand mean, the bias of an error; unit of the metric.
        view: (V,), sums to 0.
        time: (T,), sums to 0.
        rest: (V, T), the interaction and noise; each row and each column sums to 0.
    """

    mean: float
    view: Array
    time: Array
    rest: Array
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
        return float(np.square(self.rest).sum())

    def shares(self) -> dict[str, float]:
        """Part of the variance about the grand mean that is due to ``view``, ``time`` and ``rest``; 0 where nothing varies."""
        squares = {"view": self.ss_view, "time": self.ss_time, "rest": self.ss_rest}
        total = sum(squares.values())
        return {name: square / total if total else 0.0 for name, square in squares.items()}

    def variance_over_time(self, ddof: int = 1) -> float:
        """Mean over the views of the variance over time: the square of SDT but for the spread of SDT over the views."""
        views, frames = self.rest.shape
        _check_count(frames, ddof, "frames")
        return (self.ss_time + self.ss_rest) / (views * (frames - ddof))

    def variance_over_views(self, ddof: int = 1) -> float:
        """Mean over the frames of the variance over views: the square of SDV but for the spread of SDV over the frames."""
        views, frames = self.rest.shape
        _check_count(views, ddof, "views")
        return (self.ss_view + self.ss_rest) / (frames * (views - ddof))

    def sdt(self, ddof: int = 1) -> float:
        """Mean over the views of the standard deviation over time, from the parts alone."""
        _check_count(self.rest.shape[1], ddof, "frames")
        return float((self.time + self.rest).std(axis=1, ddof=ddof).mean())

    def sdv(self, ddof: int = 1) -> float:
        """Mean over the frames of the standard deviation over views, from the parts alone."""
        _check_count(self.rest.shape[0], ddof, "views")
        return float((self.view[:, None] + self.rest).std(axis=0, ddof=ddof).mean())


def decompose(values: ArrayLike, views: tuple[str, ...] = (), frames: tuple[int, ...] = ()) -> TwoWay:
    """Take a full matrix apart.

    Args:
        values: (V, T), finite, e.g. the L1 of each view and frame.
        views: names of its rows; numbers where not given.
        frames: numbers of its columns; from 0 where not given.
    """
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.ndim != 2 or matrix.size == 0:
        raise ResultsError(f"a decomposition wants values of shape (views, frames), got {matrix.shape}; give one row per view")
    if not np.isfinite(matrix).all():
        view, frame = np.argwhere(~np.isfinite(matrix))[0]
        raise ResultsError(f"a decomposition wants every cell, row {view} column {frame} is {matrix[view, frame]}; fill it")
    mean = float(matrix.mean())
    view, time = matrix.mean(axis=1) - mean, matrix.mean(axis=0) - mean
    rest = matrix - mean - view[:, None] - time
    rows, columns = views or tuple(map(str, range(len(view)))), frames or tuple(range(len(time)))
    return TwoWay(mean, view, time, rest, rows, columns)


def decompose_metric(
    results: Results, metric: str, scene: str, method: str, variant: str = "", dataset: str | None = None
) -> TwoWay:
    """`decompose` the values of one metric, method and scene.

    Raises:
        ResultsError: no such values, a missing cell (named), a value that is not finite, or values of the whole rig or sequence.
    """
    panel = read_panel(results, metric, scene, method, variant, dataset)
    views = tuple(view for view in panel.views if view is not None)
    if not views or panel.frames[0] < 0:
        raise ResultsError(f"{metric} has no value for each view and frame; take apart one that has, such as L1")
    return decompose(panel.values, views, panel.frames)


def _check_count(count: int, ddof: int, what: str) -> None:
    if count <= ddof:
        raise ResultsError(f"a deviation over {what} with ddof={ddof} needs at least {ddof + 1}, got {count}")
