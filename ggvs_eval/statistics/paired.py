"""Is one method better than another, or is that chance: paired comparisons on the same views and frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results
from ggvs_eval.statistics.intervals import LEVEL, measure_spread
from ggvs_eval.statistics.pooled_table import PooledTable, pool_table


@dataclass(frozen=True)
class Comparison:
    """The difference of two methods, first minus second.

    Attributes:
        low: lower bound of its interval; None where there is none.
        high: upper bound; None where `low` is.
        p_value: two-sided p value of no difference; None where `low` is.
        note: what is taken as given (``given this scene, these 3 views``), or why there is no interval.
        short: why the clip is too short to tell who is better, whatever the p value; empty where it is not.
    """

    difference: float
    low: float | None
    high: float | None
    p_value: float | None
    note: str
    short: str = ""


@dataclass(frozen=True)
class Standing:
    """Best method in one metric, and those that cannot be distinguished from it.

    Attributes:
        best: labels with the best number; several only where they are equal to the bit.
        ties: labels of the best and of all that tie with it.
        comparisons: label -> its difference to the best, for every other method.
        p_values: label -> its p value after Holm's correction for the number of comparisons, where there is one.
        untested: label -> why it could not be compared.
        short: why the clip is too short to name a winner over some method; empty where it is not.
    """

    best: frozenset[str]
    ties: frozenset[str]
    comparisons: Mapping[str, Comparison]
    p_values: Mapping[str, float]
    untested: Mapping[str, str]
    short: str = ""


def compare(results: Results, metric: str, first: str, second: str, dataset: str, level: float = LEVEL) -> Comparison:
    """Compare two methods on the same views and frames.

    Args:
        first: label, ``method`` or ``method+variant``.
    """
    table = pool_table(results, metric, dataset)
    for label in (first, second):
        if label not in table.values:
            raise ResultsError(f"{metric} of {label}: no values on {dataset}; there are {', '.join(table.values) or 'none'}")
    return _compare(table, first, second, level)


def rank_methods(results: Results, metric: str, higher_is_better: bool, dataset: str, level: float = LEVEL) -> Standing:
    """Find the best method of a table and compare every other one with it.

    Reading:
        A method ties with the best unless Holm's corrected p value is below 1 - level: the more methods, the harder to be told
        from the best. So does one whose difference to the best is undecided because the clip is too short for its correlation
        (`intervals.Spread.undecided`). Methods that could not be compared are ties only where their number is the same.
    """
    table = pool_table(results, metric, dataset)
    values = {label: value for label, value in table.values.items() if not np.isnan(value)}
    if not values:
        raise ResultsError(f"{metric}: no values on {dataset}; score it")
    top = (max if higher_is_better else min)(values.values())
    best = [label for label, value in values.items() if value == top]
    comparisons = {label: _compare(table, label, best[0], level) for label in values if label not in best}
    tested = {label: one.p_value for label, one in comparisons.items() if one.p_value is not None}
    p_values = dict(zip(tested, holm(list(tested.values())), strict=True))
    short = {label: one.short for label, one in comparisons.items() if one.short}
    tied = [label for label, p_value in p_values.items() if p_value >= 1.0 - level or label in short]
    untested = {label: one.note for label, one in comparisons.items() if one.p_value is None}
    return Standing(frozenset(best), frozenset(best + tied), comparisons, p_values, untested, next(iter(short.values()), ""))


def holm(p_values: Sequence[float]) -> list[float]:
    """P values corrected for their number so that one false alarm among all is as rare as it was in one (Holm 1979).

    Examples:
        >>> holm([0.01, 0.04, 0.03])
        [0.03, 0.06, 0.06]
    """
    corrected = [0.0] * len(p_values)
    largest = 0.0
    for rank, at in enumerate(sorted(range(len(p_values)), key=lambda index: p_values[index])):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[at]))
        corrected[at] = largest
    return corrected


def _compare(table: PooledTable, first: str, second: str, level: float) -> Comparison:
    """Take the difference first, so that what moves both methods alike cancels."""
    values = table.values[first], table.values[second]
    difference = 0.0 if values[0] == values[1] else values[0] - values[1]  # two infinite numbers are equal too
    try:
        ours, theirs = table.scenes_of(first), table.scenes_of(second)
        if [one.scene for one in ours] != [one.scene for one in theirs]:
            raise ResultsError(f"{first} and {second} were not measured on the same scenes; score both on each")
        spread = measure_spread([one.minus(other) for one, other in zip(ours, theirs, strict=True)])
    except ResultsError as refusal:
        return Comparison(difference, None, None, None, str(refusal))
    half = spread.half_width(level)
    return Comparison(difference, difference - half, difference + half, spread.p_value(), spread.note, spread.undecided(level))
