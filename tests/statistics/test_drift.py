"""Drift of a series: the slope of a line, and how often its interval holds the truth."""

import numpy as np
import pytest

from ggvs_eval.statistics.drift import measure_drift


def wandering(random: np.random.Generator, frames: int, correlation: float) -> np.ndarray:
    """A stationary series of variance 1 without drift."""
    series = random.normal(size=frames)
    for t in range(1, frames):
        series[t] = correlation * series[t - 1] + np.sqrt(1 - correlation**2) * series[t]
    return series


def test_the_slope_is_that_of_the_least_squares_line():
    """As numpy fits it, whatever the level; a perfect line has no error."""
    series = wandering(np.random.default_rng(1), 80, 0.5) + 30
    assert measure_drift(series).slope == pytest.approx(np.polyfit(np.arange(80), series, 1)[0])
    line = measure_drift(2.0 - 0.25 * np.arange(70))
    assert line.slope == pytest.approx(-0.25)
    assert line.half_width == pytest.approx(0.0, abs=1e-12)


def test_independent_values_have_the_textbooks_interval():
    """White noise: nearly as wide as Student's interval of a regression's slope."""
    from scipy.stats import linregress, t

    random = np.random.default_rng(2)
    ratios = []
    for _ in range(20):
        series = random.normal(size=200)
        known = t.ppf(0.975, 198) * linregress(np.arange(200), series).stderr
        ratios.append(measure_drift(series).half_width / known)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("frames", "correlation"), [(100, 0.0), (100, 0.8), (300, 0.5), (300, 0.9)]
)
def test_intervals_hold_no_drift_where_there_is_none(frames, correlation):
    """95 % of them, give or take what 400 series allow and what correlation costs."""
    random = np.random.default_rng(3)
    drifts = [measure_drift(wandering(random, frames, correlation)) for _ in range(400)]
    assert 0.9 <= np.mean([abs(drift.slope) <= drift.half_width for drift in drifts]) <= 0.985


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frames", "correlation", "count"),
    [(100, 0.0, 1000), (100, 0.8, 1000), (100, 0.9, 1000), (100, 0.95, 4000), (300, 0.95, 1000)],
)
def test_no_more_alarms_than_chance_among_what_is_not_marked(frames, correlation, count):
    """At the lengths that the table shows (from 100): 5 % of unmarked intervals exclude 0, and what
    so many series allow.

    That is enough to see 7 %; 100,000 series of 100 frames and a correlation of 0.95 gave 4.7 to
    4.9 %.
    """
    random = np.random.default_rng(3)
    drifts = [measure_drift(wandering(random, frames, correlation)) for _ in range(count)]
    unmarked = [abs(drift.slope) > drift.half_width for drift in drifts if not drift.short]
    assert np.mean(unmarked) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / len(unmarked))


def test_a_clear_drift_is_not_marked():
    """A slope of ten times its error is called; errors that last for a whole clip leave too few
    frames, and it says so.
    """
    random = np.random.default_rng(6)
    drift = measure_drift(wandering(random, 120, 0.5) + 0.2 * np.arange(120))
    assert drift.short == ""
    assert drift.slope - drift.half_width > 0
    assert "clip too short" in measure_drift(np.sin(np.linspace(0, 2.5 * np.pi, 60))).short
