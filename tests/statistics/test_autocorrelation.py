"""Errors of means of correlated series: Student's t in the simplest case, exact variances, laws,
and coverage.
"""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from scipy.fft import dct

from ggvs_eval.statistics import autocorrelation
from ggvs_eval.statistics.autocorrelation import (
    ErrorOfMean,
    correlation_models,
    correlation_posterior,
    model_variances,
    tail_probability,
    total_half_width,
    total_tail,
)
from helpers.tidy_tables import autoregressive

SERIES = arrays(
    np.float64, st.integers(4, 40), elements=st.integers(-1000, 1000).map(float), unique=True
)


def half_width(series) -> float:
    return ErrorOfMean.of_series(np.asarray(series)).half_width(0.05)


def test_independent_frames_give_students_interval(monkeypatch):
    """With the one model of independent frames, the interval is Student's to rounding, and so is
    the p value.
    """
    series = np.random.default_rng(1).standard_normal(24)
    independent = model_variances(24, np.zeros(1), np.zeros(1), np.ones(1))
    monkeypatch.setattr(autocorrelation, "correlation_models", lambda frames: independent)
    error = ErrorOfMean.of_series(series)
    low, high = stats.t.interval(0.95, 23, series.mean(), stats.sem(series))
    assert error.half_width(0.05) == pytest.approx((high - low) / 2, rel=1e-10)
    assert error.tail(abs(series.mean())) == pytest.approx(
        stats.ttest_1samp(series, 0.0).pvalue, rel=1e-10
    )


@pytest.mark.parametrize(
    ("frames", "correlation", "share"),
    [(2, 0.5, 0.0), (9, -0.8, 0.0), (24, 0.9, 0.3), (50, 0.0, 0.6)],
)
def test_variances_are_those_of_the_whole_covariance(frames, correlation, share):
    """Variances of the mean and of the cosine coefficients are the diagonal of the transformed
    covariance matrix.
    """
    lags = np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
    covariance = (1.0 - share) * np.asarray(correlation) ** lags + share * np.eye(frames)
    basis = dct(np.eye(frames), axis=0, norm="ortho")
    diagonal = np.diag(basis @ covariance @ basis.T)
    models = model_variances(frames, np.array([correlation]), np.array([share]), np.ones(1))
    of_mean = diagonal[0] / frames
    assert 1.0 / models.worth[0] == pytest.approx(of_mean, rel=1e-12)
    np.testing.assert_allclose(models.variances[0], diagonal[1:] / of_mean, rtol=1e-9)


def test_memory_grows_with_the_length_of_a_clip_alone():
    """Ten minutes of frames take the memory of a few arrays of that length for each model, not of
    its square.
    """
    frames = 18_000
    correlation_models.cache_clear()
    tracemalloc.start()
    correlation_posterior(np.random.default_rng(6).standard_normal(frames))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    n_models = len(correlation_models(frames).prior)
    assert peak < 8 * n_models * frames * np.dtype(float).itemsize


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
def test_long_clips_find_the_long_run_variance(correlation):
    """Over 1500 frames the width is that of the known variance of an autoregression, (1 + c) / (1 -
    c) / T, within a fifth.
    """
    widths = [
        half_width(one) for one in autoregressive(np.random.default_rng(4), 12, 1500, correlation)
    ]
    assert np.median(widths) == pytest.approx(
        1.96 * np.sqrt((1 + correlation) / (1 - correlation) / 1500), rel=0.2
    )


@given(SERIES, st.floats(0.01, 100.0), st.floats(-1e3, 1e3))
@settings(max_examples=40, deadline=None)
def test_scale_and_shift(series, scale, shift):
    """A scale scales the width, a shift leaves it, and so does a change of sign."""
    width = half_width(series)
    assert half_width(scale * series) == pytest.approx(scale * width, rel=1e-6)
    assert half_width(series + shift) == pytest.approx(width, rel=1e-6)
    assert half_width(-series) == pytest.approx(width, rel=1e-9)


@given(SERIES)
@settings(max_examples=40, deadline=None)
def test_time_has_no_direction_but_an_order(series):
    """A clip played backwards is as certain; sorted, which is as slow as can be, it is worth no
    more frames than alternating.
    """
    assert half_width(series[::-1]) == pytest.approx(half_width(series), rel=1e-7)
    ranked = np.sort(series)
    alternating = np.empty_like(ranked)
    alternating[::2], alternating[1::2] = (
        ranked[: (len(ranked) + 1) // 2],
        ranked[(len(ranked) + 1) // 2 :][::-1],
    )
    assert correlation_posterior(ranked).worth <= correlation_posterior(alternating).worth


@given(SERIES, st.floats(1e-6, 0.9))
@settings(max_examples=40, deadline=None)
def test_tail_and_width_are_inverse(series, tail):
    """The tail of a half width is the tail that it was asked for, of one error and of sums
    of two.
    """
    error = ErrorOfMean.of_series(series)
    assert error.tail(error.half_width(tail)) == pytest.approx(tail, rel=1e-6)
    both = (error, ErrorOfMean.of_sample(series))
    assert total_half_width(both, tail) > error.half_width(tail)
    assert total_tail(both, total_half_width(both, tail)) == pytest.approx(tail, rel=1e-5)


def test_what_never_varies_is_certain_and_long_enough():
    """A constant clip, of two frames or many, has no error; no model has a coefficient without
    variance, priors sum to 1.
    """
    for frames in (2, 3, 24):
        error = ErrorOfMean.of_series(np.full(frames, 3.0))
        assert (error.half_width(0.05), error.tail(0.0), error.tail(1e-9)) == (0.0, 1.0, 0.0)
    assert correlation_posterior(np.zeros(24)).worth == 24.0
    for frames in (2, 3, 24, 300):
        models = correlation_models(frames)
        assert models.prior.sum() == pytest.approx(1.0)
        assert models.variances.min() > 0.0
        assert models.variances.shape == (len(models.prior), frames - 1)


@pytest.mark.parametrize(
    ("frames", "correlation"),
    [(24, 0.0), (24, 0.3), (24, 0.5), (24, 0.7), (100, 0.0), (100, 0.9), (300, 0.0), (300, 0.9)],
)
def test_intervals_cover(frames, correlation):
    """Nominal 95 % is 93 to 98 % of 1500 clips, where drawn blocks covered 87 % (24, 0.7) and 90 %
    (100, 0.9).
    """
    series = autoregressive(np.random.default_rng(12), 1500, frames, correlation)
    posterior = correlation_posterior(series)
    tails = tail_probability(
        series.mean(axis=1), posterior.weights, posterior.scales, posterior.freedom
    )
    assert 0.93 <= np.mean(tails >= 0.05) <= 0.98


def test_a_clip_of_a_few_independent_frames_says_so():
    """Most clips of 24 frames that are worth two say so; of those that are worth nine,
    hardly any.
    """
    generator = np.random.default_rng(5)
    slow, fast = (
        [
            bool(ErrorOfMean.of_series(one).short)
            for one in autoregressive(generator, 200, 24, correlation)
        ]
        for correlation in (0.9, 0.4)
    )
    assert np.mean(slow) > 0.6
    assert np.mean(fast) < 0.05
