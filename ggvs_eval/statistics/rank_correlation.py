"""Answer of a metric to a degradation of known strength: rank correlation with its interval, and
least detected strength.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ggvs_eval.arrays import Array

LEVEL = 0.95
DRAWS = 2000
Verdict = Literal["sees", "blind", "rewards", "unclear"]


@dataclass(frozen=True)
class Answer:
    """Answer of a metric to a degradation.

    Attributes:
        correlation: Spearman's, of strength and how much worse the metric says it is, mean over
            clips; +1 if the metric gets worse with every step, -1 if it gets better, 0 if it does
            not change.
        low: lower bound of the bootstrap interval over clips; None of one clip.
        least_strength: least strength from which on the mean worsening is larger than the spread
            over clips; None if there is none, or one clip.
    """

    correlation: float
    low: float | None
    high: float | None
    least_strength: float | None
    clips: int

    @property
    def verdict(self) -> Verdict:
        """Answer in a word: ``sees`` the degradation, is ``blind`` to it, ``rewards`` it.

        ``unclear`` of one clip.
        """
        if self.low is None or self.high is None:
            return "unclear"
        if self.low > 0:
            return "sees"
        return "rewards" if self.high < 0 else "blind"


def answer(
    strengths: Sequence[float], worse: Mapping[str, Sequence[Sequence[float]]], seed: int = 0
) -> Answer:
    """Find out how a metric answers a ladder of strengths.

    Args:
        strengths: rising, (S,); the first is 0 if the undegraded has a value.
        worse: clip -> one row for each seed of the degradation, (S,): the metric's values, turned
            so that more is worse.

    Example:
        >>> found = answer(
        ...     [0, 1, 2], {"first": [[30.0, 31.0, 35.0]], "second": [[29.0, 31.5, 34.0]]}
        ... )
        >>> found.correlation, found.verdict, found.least_strength
        (1.0, 'sees', 1)

    Reading:
        Clips are drawn, with all their seeds, since the seeds of a clip are not independent. What a
        metric distinguishes is larger than the standard deviation over clips and seeds, of the
        undegraded or of the degraded ones, whichever is larger.
    """
    of_clips = np.array(
        [np.mean([rank_correlation(strengths, row) for row in rows]) for rows in worse.values()]
    )
    if len(of_clips) < 2:
        return Answer(
            correlation=float(of_clips.mean()),
            low=None,
            high=None,
            least_strength=None,
            clips=len(of_clips),
        )
    draws = np.random.default_rng(seed).integers(len(of_clips), size=(DRAWS, len(of_clips)))
    low, high = np.quantile(of_clips[draws].mean(axis=1), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    rows = np.array([row for of_clip in worse.values() for row in of_clip], dtype=np.float64)
    return Answer(
        correlation=float(of_clips.mean()),
        low=float(low),
        high=float(high),
        least_strength=_least(strengths, rows),
        clips=len(of_clips),
    )


def rank_correlation(strengths: Sequence[float], worse: Sequence[float]) -> float:
    """Spearman's rank correlation; 0 if all values are equal."""
    from scipy.stats import spearmanr

    if np.ptp(worse) == 0:
        return 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return float(spearmanr(strengths, worse).statistic)


def _least(strengths: Sequence[float], rows: Array) -> float | None:
    """Return the least strength from which on the worsening exceeds the spread, of values
    (N, S).
    """
    spread = np.maximum(rows.std(axis=0, ddof=1), rows[:, 0].std(ddof=1))
    tells = (rows - rows[:, :1]).mean(axis=0) > spread
    tells[0] = False
    if strengths[0] != 0:
        return None
    blind = np.flatnonzero(~tells)
    after = int(blind[-1]) + 1
    return None if after == len(strengths) else strengths[after]
