"""Drift of a series: its least-squares slope over time, with an interval that knows that errors
last from frame to frame.
"""

from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.statistics.autocorrelation import ErrorOfMean, correlation_posterior, describe_short
from ggvs_eval.statistics.intervals import LEVEL

FEWEST = 4.0  # independent frames; a slope of fewer is marked
# intervals of a slope from which on it is none of the slow wandering that looks like a line
CLEAR = 3.0


@dataclass(frozen=True)
class Drift:
    """Slope of a series.

    Attributes:
        slope: per frame.
        half_width: of its interval.
        short: why the series is too short for its correlation; empty if it is not.
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
        Over clips that are long for their correlation the variances of a slope and of a mean have
        one cause, the variance of what scatters about the line times the frames that one
        independent frame lasts; so the slope's error is the mean's, times the root of T over the
        sum of squared times. The line has taken two degrees of freedom, of those that independent
        frames leave, and of what scatters about it one more than a mean has: with n independent
        frames its variance is (n - 1) / (n - 2) as large. A line takes slow wandering away with it,
        so a series is short for its correlation where it is with the line or without, unless its
        slope is three times its interval. From 100 frames and up to a correlation of 0.95 at most 5
        % of the intervals that are not short exclude 0 without drift (3.6 to 4.9 % of at least
        20,000 series each).
    """
    times = np.arange(len(series)) - (len(series) - 1) / 2
    squares = float(times @ times)
    slope = float(times @ series) / squares
    posterior = correlation_posterior(series - series.mean() - slope * times)
    worth = float(posterior.worth)
    scales = posterior.scales * np.sqrt(
        len(series) / squares * max(worth - 1.0, 1.0) / max(worth - 2.0, 1.0)
    )
    half = ErrorOfMean(posterior.weights, scales, max(worth - 2.0, 1.0)).half_width(1 - level)
    if worth >= FEWEST and abs(slope) <= CLEAR * half:
        worth = min(worth, float(correlation_posterior(series).worth))
    return Drift(slope, half, describe_short(len(series), worth, FEWEST))
