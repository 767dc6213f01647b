"""Error of the mean of a short, autocorrelated series: Student's t, averaged over the correlations
it allows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import dct, dst
from scipy.optimize import brentq
from scipy.special import stdtr, stdtrit

from ggvs_eval.arrays import Array
from ggvs_eval.progress import counted

CORRELATIONS = 30
LEAST_CORRELATION = -0.9
LEAST_WORTH = 0.5  # independent frames that a clip of the strongest correlation is worth
# of the variance, in models with noise of each frame upon the correlated part
NOISE_SHARES = (0.3, 0.6)
NOISE_FROM = 0.3  # correlation from which such noise is worth a model
NOISE_PRIOR = 0.05
FEWEST_WORTH = 4.0  # independent frames below which an interval covers too seldom
# to call a difference; at 8, 5 to 8 % of equal pairs were called different in 6 to 12 frames
FEWEST_CALLED = 10.0
SMALLEST_TAIL = 1e-12


@dataclass(frozen=True)
class Models:
    """Correlations that a series of T values may have, each so far scaled that the mean has
    variance 1.

    Attributes:
        variances: (G, T - 1), variance of each cosine coefficient.
        prior: (G,), sums to 1.
        worth: (G,), independent values with as certain a mean.
    """

    variances: Array
    prior: Array
    worth: Array


@dataclass(frozen=True)
class Posterior:
    """Posterior distribution of the errors of the means of series: a mixture of Student's t
    distributions.

    Attributes:
        weights: (..., G), sum to 1.
        scales: (..., G), standard errors of the mean, one per model.
        freedom: degrees of freedom of each.
        worth: (...), geometric mean of the independent values with as certain a mean.
    """

    weights: Array
    scales: Array
    freedom: float
    worth: Array


@dataclass(frozen=True)
class ErrorOfMean:
    """Random error of one mean: a mixture of Student's t distributions.

    Attributes:
        weights: (G,), sum to 1.
        scales: (G,), standard errors.
        freedom: degrees of freedom.
        short: why the series is too short for its correlation, so that intervals are perhaps too
            narrow; empty if it is not.
        worth: independent values with as certain a mean; infinite of values that are independent.
        frames: length of the series; 0 of values that are independent.
    """

    weights: Array
    scales: Array
    freedom: float
    short: str = ""
    worth: float = math.inf
    frames: int = 0

    @classmethod
    def of_sample(cls, values: Array, count: int = 1) -> "ErrorOfMean":
        """Student's error of the mean of independent values, over `count`."""
        scale = values.std(ddof=1) / math.sqrt(len(values)) / count
        return cls(np.ones(1), np.array([scale]), len(values) - 1.0)

    @classmethod
    def of_series(
        cls, series: Array, variance: Array | float = 0.0, count: int = 1, squares: bool = False
    ) -> "ErrorOfMean":
        """Error of the mean of a series or of squares, less a variance counted elsewhere (under
        each model), over `count`.

        Reading:
            Given a model, the scale of normal values is known by all of them. Squares are not
            normal, and their scale is known by the independent ones alone (Satterthwaite's degrees
            of freedom): 6 % of false alarms at T = 100 and a correlation of 0.9 in place of 7 to 8.
        """
        posterior = correlation_posterior(series)
        scales = np.sqrt(np.maximum(np.square(posterior.scales) - variance, 0.0)) / count
        worth = float(posterior.worth)
        freedom = max(worth - 1.0, 1.0) if squares else posterior.freedom
        short = describe_short(len(series), worth, FEWEST_WORTH, "interval perhaps too narrow")
        return cls(posterior.weights, scales, freedom, short, worth, len(series))

    def tail(self, size: float) -> float:
        """Return the probability of an error of at least this size, up or down."""
        return float(tail_probability(np.float64(size), self.weights, self.scales, self.freedom))

    def half_width(self, tail: float) -> float:
        """Return the error that is reached, up or down, with probability `tail`."""
        widest = self.greatest_half_width(tail)
        if widest <= 0.0 or self.tail(widest) >= tail:
            return widest
        return float(
            brentq(
                lambda size: self.tail(size) - tail, 0.0, widest, xtol=1e-13 * widest, rtol=1e-13
            )
        )

    def greatest_half_width(self, tail: float) -> float:
        """Return the same under the strongest correlation that is thought of, however unlikely."""
        return max(float(self.scales.max()) * -float(stdtrit(self.freedom, tail / 2.0)), 0.0)


def describe_short(
    frames: int, worth: float, least: float = FEWEST_CALLED, claim: str = "clip too short"
) -> str:
    """State in words why a clip is too short for a verdict; empty if it is not.

    Args:
        frames: of the clip.
        worth: independent frames that would be as certain.
        least: as many as a verdict needs.
        claim: what follows from it.

    Examples:
        >>> describe_short(23, 2.4)
        'clip too short: 2 independent frames, 10 needed'
    """
    if worth >= least:
        return ""
    independent = max(1, min(frames, math.floor(worth)))
    return f"{claim}: {counted(independent, 'independent frame')}, {least:g} needed"


def correlation_posterior(series: ArrayLike) -> Posterior:
    """Weigh the correlations that evenly spaced, stationary series allow.

    Args:
        series: (..., T), T >= 2.

    Reading:
        The effective sample size of a clip is its length over the frames that one independent frame
        lasts, (1 + c) / (1 - c) for correlation c from frame to frame. With few frames c is known
        badly: one estimate of it gives intervals that cover too seldom, or far too wide ones where
        it comes near 1. So all correlations count, evenly spread from -0.9 up to where the clip is
        worth half a frame, each with its likelihood; one twentieth goes to models in which each
        frame has additional noise of its own (30 or 60 % of the variance). Given a model, the
        cosine coefficients of the clip (those of Lazarus, Lewis, Stock & Watson 2018) are
        independent with known ratios of variances, Student's t with T - 1 degrees of freedom
        follows, and their average is the posterior under a flat prior of mean and log variance
        (Zellner & Tiao 1964). Of the methods in `benchmarks/interval_coverage.py` it is the
        narrowest that covers 92 to 97 % up to 0.7 at 24 frames and 0.9 at 100; prewhitened cosines
        cover about as well and are up to 1.9 times as wide.
    """
    values = np.asarray(series, dtype=np.float64)
    frames = values.shape[-1]
    models = correlation_models(frames)
    energies = np.square(
        dct(values - values.mean(axis=-1, keepdims=True), axis=-1, norm="ortho")[..., 1:]
    )
    total = energies.sum(axis=-1, keepdims=True)
    relative = energies / np.where(total > 0.0, total, 1.0)
    scaled = np.where(total > 0.0, relative @ (1.0 / models.variances).T, 1.0)  # (..., G)
    logarithm = (
        np.log(models.prior)
        - 0.5 * np.log(models.variances).sum(axis=1)
        - 0.5 * (frames - 1) * np.log(scaled)
    )
    weights = np.where(
        total > 0.0, np.exp(logarithm - logarithm.max(axis=-1, keepdims=True)), models.prior
    )
    weights /= weights.sum(axis=-1, keepdims=True)
    worth = np.where(total[..., 0] > 0.0, np.exp(weights @ np.log(models.worth)), frames)
    return Posterior(
        weights=weights,
        scales=np.sqrt(scaled * total / (frames - 1)),
        freedom=frames - 1.0,
        worth=worth,
    )


@lru_cache(maxsize=16)
def correlation_models(frames: int) -> Models:
    """Return the models of a series of this many frames: autoregressive ones, and some with
    additional noise of each frame.
    """
    longest = frames / LEAST_WORTH
    strongest = (longest - 1.0) / (longest + 1.0)
    grid = np.tanh(np.linspace(math.atanh(LEAST_CORRELATION), math.atanh(strongest), CORRELATIONS))
    noisy = grid[grid > NOISE_FROM]
    correlations, shares = np.concatenate([grid, *[noisy] * len(NOISE_SHARES)]), [0.0] * len(grid)
    prior = [(1.0 - NOISE_PRIOR) * _even(grid) if len(noisy) else _even(grid)]
    for share in NOISE_SHARES:
        shares += [share] * len(noisy)
        prior.append(NOISE_PRIOR / len(NOISE_SHARES) * _even(noisy))
    return model_variances(frames, correlations, np.array(shares), np.concatenate(prior))


def model_variances(frames: int, correlations: Array, shares: Array, prior: Array) -> Models:
    """Return the variances of the mean and of the cosine coefficients of series, exactly.

    Coefficient j of lag l overlaps itself by (1 - l / T) cos(pi j l / T) - sin(pi j l / T) / (T
    sin(pi j / T)); the sums over lags are a cosine and a sine transform, so that memory grows with
    T alone.

    Args:
        correlations: (G,), from frame to frame, of the correlated part.
        shares: (G,), of white noise in the variance.
        prior: (G,).
    """
    lag = np.arange(1, frames)
    autocorrelation = (1.0 - shares)[:, None] * correlations[:, None] ** lag  # (G, T - 1)
    faded = autocorrelation * (1.0 - lag / frames)
    of_mean = (1.0 + 2.0 * faded.sum(axis=1)) / frames
    cosines = dct(np.pad(faded, ((0, 0), (1, 1)), constant_values=(1.0, 0.0)), type=1)[:, 1:-1]
    sines = dst(autocorrelation, type=1) / (frames * np.sin(np.pi * lag / frames))
    return Models((cosines - sines) / of_mean[:, None], prior, 1.0 / of_mean)


def tail_probability(
    size: Array | np.float64, weights: Array, scales: Array, freedom: float
) -> Array:
    """Return the two-sided probability of errors of at least this size (...,) under mixtures of
    Student's t, (..., G) each.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(size)[..., None] / scales
    tails = np.where(np.isnan(ratio), 1.0, 2.0 * stdtr(freedom, -ratio))
    return np.asarray((weights * tails).sum(axis=-1))


def total_half_width(parts: Sequence[ErrorOfMean], tail: float) -> float:
    """Return half width of the sum of independent errors: half widths add as roots of squares (Zou
    & Donner 2008).
    """
    return math.hypot(*(part.half_width(tail) for part in parts))


def total_tail(parts: Sequence[ErrorOfMean], size: float) -> float:
    """Return the probability at which the half width of the sum is `size`; never below 1e-12."""
    if size == 0.0:
        return 1.0
    if len(parts) == 1:
        return max(parts[0].tail(size), SMALLEST_TAIL)
    if total_half_width(parts, SMALLEST_TAIL) <= size:
        return SMALLEST_TAIL
    excess = lambda log_tail: total_half_width(parts, math.exp(log_tail)) - size  # noqa: E731
    return math.exp(float(brentq(excess, math.log(SMALLEST_TAIL), 0.0, xtol=1e-9)))


def _even(correlations: Array) -> Array:
    """Return the weights that make points evenly spaced in artanh represent an even spread."""
    return (1.0 - correlations**2) / (1.0 - correlations**2).sum()
