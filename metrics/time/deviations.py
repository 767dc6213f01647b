"""Deviations of the error: SDT over the frames of a view, SDV over the views of an instant."""

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import require_finite
from ggvs_eval.metrics.metric import CONSISTENCY, MetricOptions, Row, TableMetric
from ggvs_eval.statistics.pooling import Pooling

Errors = Mapping[str, Mapping[int, float]]  # view -> frame -> L1


def sdt(l1_255: ArrayLike, ddof: int = 1) -> float:
    """Return the standard deviation of the error over time, mean over the views; lower is steadier.

    Args:
        l1_255: L1 of each view and frame on the scale 0..255, (V, T), T >= 2.
        ddof: 1 for the unbiased estimate, 0 for the plain one.

    Raises:
        MetricError: not a table of views and frames, or fewer than 2 frames.

    Example:
        >>> sdt([[1.0, 3.0], [5.0, 5.0]], ddof=0)  # of two views: 1 and 0
        0.5

    Reading:
        The paper defines SDT by words only. A standard deviation per view over its per-frame errors
        (not per pixel, not of the error averaged over views) is what its sizes allow; ddof=1 is
        what its authors' earlier released code uses.
    """
    errors = np.asarray(l1_255, dtype=np.float64)
    if errors.ndim != 2 or errors.shape[1] < 2:
        raise MetricError(
            f"SDT wants errors of shape (views, frames) with at least 2 frames, got {errors.shape}"
        )
    return require_finite(float(errors.std(axis=1, ddof=ddof).mean()), "SDT")


def sdv(l1_255: ArrayLike, ddof: int = 1) -> float:
    """Return the standard deviation of the error over the views, mean over the frames.

    Lower is more even.

    Args:
        l1_255: L1 of each view and frame on the scale 0..255, (V, T), V >= 2.
        ddof: 1 for the unbiased estimate, 0 for the plain one; with 3 views they differ by 22 %.

    Raises:
        MetricError: not a table of views and frames, fewer than 2 views, or values that are not
            finite.

    Example:
        >>> sdv([[1.0, 3.0], [5.0, 5.0]], ddof=0)  # of two frames: 2 and 1
        1.5

    Reading:
        Defined by words only in the paper; read as the mirror of `sdt`, ddof=1 as there.
    """
    errors = np.asarray(l1_255, dtype=np.float64)
    if errors.ndim != 2 or errors.shape[0] < 2 or errors.shape[1] < 1:
        raise MetricError(
            f"SDV wants errors of shape (views, frames) with at least 2 views, got {errors.shape}"
        )
    return require_finite(float(errors.std(axis=0, ddof=ddof).mean()), "SDV")


def _rows_of_views(errors: Errors, options: MetricOptions) -> list[Row]:
    """SDT of each view with two frames or more, of any instants."""
    frames = {frame for of_view in errors.values() for frame in of_view}
    if len(frames) < 2:
        raise MetricError(f"{len(frames)} frame; needs 2")
    return [
        (view, -1, sdt([list(of_view.values())], options.ddof))
        for view, of_view in errors.items()
        if len(of_view) > 1
    ]


def _rows_of_frames(errors: Errors, options: MetricOptions) -> list[Row]:
    """SDV of each frame that two views or more have."""
    if len(errors) < 2:
        raise MetricError(f"{len(errors)} view; needs 2")
    by_frame: dict[int, list[float]] = defaultdict(list)
    for of_view in errors.values():
        for frame, value in of_view.items():
            by_frame[frame].append(value)
    having = [(frame, values) for frame, values in sorted(by_frame.items()) if len(values) > 1]
    return [
        (None, frame, sdv([[value] for value in values], options.ddof)) for frame, values in having
    ]


SDT = TableMetric(
    name="SDT",
    kind="view",
    function=sdt,
    unit="grey levels of 255",
    higher_is_better=False,
    group=CONSISTENCY,
    decimals=3,
    pooling=lambda options: Pooling("deviation over frames", ("L1",), {"ddof": options.ddof}),
    describe="standard deviation of L1 over the frames of a view",
    reference="Ha et al. 2025, section 4",
    part="L1",
    rows=_rows_of_views,
)
SDV = TableMetric(
    name="SDV",
    kind="rig",
    function=sdv,
    unit="grey levels of 255",
    higher_is_better=False,
    group=CONSISTENCY,
    decimals=3,
    pooling=lambda options: Pooling("deviation over views", ("L1",), {"ddof": options.ddof}),
    describe="standard deviation of L1 over the views of an instant",
    reference="Ha et al. 2025, section 4",
    part="L1",
    rows=_rows_of_frames,
)
