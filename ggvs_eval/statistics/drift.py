"""Drift of a series: its least-squares slope over time, with an interval that knows that errors last from frame to frame."""

from dataclasses import dataclass, replace

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.statistics.autocorrelation import ErrorOfMean
from ggvs_eval.statistics.intervals import LEVEL


@dataclass(frozen=True)
class Drift:
    """Slope of a series.

    Attributes:
        slope: per frame.
        half_width: of its interval.
        short: why the series is too short for its correlation; empty where it is not.
    """

    slope: float
    half_width: float
    short: str = ""


def measure_drift(series: Array, level: float = LEVEL) -> Drift:
    """Fit a line to evenly spaced values, (T,), T >= 3.

    Examples:
        >>> measure_drift(np.array([1.0, 3.0, 5.0, 7.0])).slope
        2.0

    Reading:
        Over clips that are long for their correlation the variances of a slope and of a mean have one cause, the variance of what
        lies about the line times the frames that one independent frame lasts; so the slope's error is the mean's, times the root
        of T over the sum of squared times. The line has taken two degrees of freedom. Of series of 100 and 300 frames without
        drift 92 to 97 % of the intervals hold 0 up to a correlation of 0.9 (`tests/statistics/test_drift.py`).
    """
    times = np.arange(len(series)) - (len(series) - 1) / 2
    squares = float(times @ times)
    slope = float(times @ series) / squares
    rest = series - series.mean() - slope * times
    error = ErrorOfMean.of_series(rest)
    freedom = max(error.freedom - 1.0, 1.0)
    of_slope = replace(error, scales=error.scales * np.sqrt(len(series) / squares * error.freedom / freedom), freedom=freedom)
    return Drift(slope, of_slope.half_width(1 - level), error.short)
