"""Blocks of neighbouring frames: how long they must be, and how often each frame is drawn with them."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ggvs_eval.arrays import Array

FEWEST_BLOCKS = 4
NEGLIGIBLE = 1.96  # standard errors below which an autocorrelation counts as none
NEGLIGIBLE_RUN = 5


def block_length(series: ArrayLike) -> int:
    """Length of the blocks for a moving-block bootstrap of the mean of a stationary series.

    Args:
        series: (T,), evenly spaced in time.

    Returns:
        Frames per block, from 1 to T / 4 (so that there are at least four blocks).

    Reading:
        The automatic rule of Politis & White 2004, corrected by Patton, Politis & White 2009 for blocks of fixed length, gives
        the best variance, of the order T ** (1/3). Intervals cover best with longer blocks, of the order T ** (1/2) (Sun,
        Phillips & Jin 2008), so it is multiplied by T ** (1/6), and ceil(T ** (1/2)) is the least: where noise hides a weak
        autocorrelation the automatic rule falls to 1, and the correction for few blocks pays for blocks that are too long.
    """
    values = np.asarray(series, dtype=np.float64)
    frames = len(values)
    longest = max(1, frames // FEWEST_BLOCKS)
    return min(longest, max(math.ceil(math.sqrt(frames)), math.ceil(_automatic_length(values) * frames ** (1 / 6))))


def block_weights(generator: np.random.Generator, resamples: int, frames: int, length: int) -> Array:
    """Weights of the frames in resamples made of blocks drawn with replacement from all overlapping ones.

    Args:
        generator: source of chance.
        resamples: R.
        frames: T.
        length: frames per block; the last block is cut off at T frames.

    Returns:
        (R, T), how often each frame was drawn over T; rows sum to 1.
    """
    blocks = math.ceil(frames / length)
    starts = generator.integers(0, frames - length + 1, size=(resamples, blocks))
    drawn = (starts[:, :, None] + np.arange(length)).reshape(resamples, -1)[:, :frames]
    return _shares(drawn, frames)


def unit_weights(generator: np.random.Generator, resamples: int, units: int) -> Array:
    """The same for units drawn one by one, such as views or scenes: (R, units)."""
    return _shares(generator.integers(0, units, size=(resamples, units)), units)


def _shares(drawn: NDArray[np.int64], count: int) -> Array:
    """How often each of `count` things was drawn in each row, over the length of the row."""
    rows = np.arange(len(drawn))[:, None] * count
    counts = np.bincount((drawn + rows).ravel(), minlength=len(drawn) * count)
    return counts.reshape(len(drawn), count) / drawn.shape[1]


def _automatic_length(values: Array) -> float:
    """Block length that minimises the error of the bootstrap variance, with a flat-top lag window; 1 where nothing varies."""
    frames = len(values)
    centred = values - values.mean()
    variance = float(centred @ centred)
    if frames < 2 * NEGLIGIBLE_RUN or variance <= 1e-24 * float(values @ values):
        return 1.0
    lags = min(frames - 1, math.ceil(math.sqrt(frames)) + NEGLIGIBLE_RUN)
    correlation = np.array([centred[lag:] @ centred[: frames - lag] for lag in range(1, lags + 1)]) / variance
    window = min(lags, 2 * _last_lag_that_counts(correlation, frames))
    lag = np.arange(1, window + 1)
    weight = np.clip(2.0 * (1.0 - lag / max(window, 1)), 0.0, 1.0) * correlation[:window]
    spectrum, slope = 1.0 + 2.0 * weight.sum(), 2.0 * (weight * lag).sum()
    if spectrum <= 0.0:
        return 1.0
    return float(max(1.0, (1.5 * (slope / spectrum) ** 2 * frames) ** (1 / 3)))


def _last_lag_that_counts(correlation: Array, frames: int) -> int:
    """Lag before the first run of negligible autocorrelations; the last significant one where there is no such run."""
    significant = np.abs(correlation) > NEGLIGIBLE * math.sqrt(math.log10(frames) / frames)
    for lag in range(len(correlation) - NEGLIGIBLE_RUN + 1):
        if not significant[lag : lag + NEGLIGIBLE_RUN].any():
            return lag
    return int(np.flatnonzero(significant)[-1]) + 1 if significant.any() else 0
