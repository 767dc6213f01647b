"""Judgement of methods: paired comparisons on the same views and frames, and what may be said of the best from them."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results, label_of, without_labels
from ggvs_eval.statistics.intervals import LEVEL, Interval, measure_spread, table_intervals
from ggvs_eval.statistics.pooled import PooledTable, pool_table

# Of the first of two methods. Too short: the clip allows no answer, which is not the same as "as good".
Outcome = Literal["better", "worse", "as good", "equal", "too short", "untested"]
OUTCOMES: Mapping[Outcome, str] = {
    **{"better": "better", "worse": "worse", "as good": "not significantly different", "equal": "equal"},
    **{"too short": "too short to call", "untested": "not tested"},
}
NOT_WORSE: tuple[Outcome, ...] = ("better", "as good", "equal")
BEYOND = "is better than the captured images, a sign of blur"
ELSEWHERE = "was measured on other views or frames than the others"


@dataclass(frozen=True)
class Comparison:
    """The difference of two methods, first minus second.

    Attributes:
        low: lower bound of its interval; None if there is none.
        high: upper bound; None where `low` is.
        p_value: two-sided p value of no difference; None where `low` is.
        note: what is taken as given (``given this scene, these 3 views``), or why there is no interval.
        short: why the clip is too short to call it, regardless of the p value; empty if it is not.
        is_clear: whether even too short a clip would be long enough to call it.
        corrected: p value after Holm's correction for the comparisons that it was made with.
        outcome: of the first method; ``untested`` before it was decided, see `decide`.
    """

    difference: float
    low: float | None
    high: float | None
    p_value: float | None
    note: str
    short: str = ""
    is_clear: bool = False
    corrected: float | None = None
    outcome: Outcome = "untested"


@dataclass(frozen=True)
class Judgement:
    """Standing of the methods in one metric on one data set: the one place from which reports take who is better.

    Attributes:
        best: label of the best number among the contenders; empty if nothing is ranked.
        comparisons: label -> its decided difference to the best, for every other method that is ranked.
        variants: ranked methods that do not compete, since one of their kind competes for all -> their difference to that one.
        unranked: label -> why its number is not ranked, as it follows the name.
        intervals: label -> interval of its number, or why there is none; not of methods that are set aside.
    """

    best: str
    comparisons: Mapping[str, Comparison]
    variants: Mapping[str, Comparison]
    unranked: Mapping[str, str]
    intervals: Mapping[str, Interval]

    @property
    def rivals(self) -> tuple[str, ...]:
        """Contenders but the best."""
        return tuple(label for label in self.comparisons if label not in self.variants)

    def having(self, *outcomes: Outcome) -> tuple[str, ...]:
        """Rivals of these outcomes against the best."""
        return tuple(label for label in self.rivals if self.comparisons[label].outcome in outcomes)

    @property
    def winner(self) -> str:
        """Label of the best where every rival is worse; empty if there is no rival, or no decision."""
        return self.best if self.rivals and len(self.having("worse")) == len(self.rivals) else ""

    @property
    def undecided(self) -> str:
        """Return why no winner is named although no rival is as good: a short clip, no test, no rival."""
        if not self.rivals:
            return "the others are not ranked" if self.unranked else ""
        short, untested = self.having("too short"), self.having("untested")
        if short:
            return self.comparisons[short[0]].short
        if len(untested) == len(self.rivals):
            return f"nothing could be compared ({self.comparisons[untested[0]].note})"
        return f"not compared with {untested[0]}: {self.comparisons[untested[0]].note}" if untested else ""

    @property
    def marked(self) -> frozenset[str]:
        """Labels of the best and of what is not worse; none if that is undecided, or would be every method."""
        if self.undecided:
            return frozenset()
        level = {self.best, *(label for label, one in self.comparisons.items() if one.outcome in NOT_WORSE)}
        return frozenset(level) if len(level) <= len(self.comparisons) else frozenset()

    def interval(self, label: str) -> Interval | None:
        """Return the interval of a method; its note also says why it was not compared with the best."""
        interval, one = self.intervals.get(label), self.comparisons.get(label)
        if interval is None or one is None or one.p_value is not None or one.note == interval.note:
            return interval
        note = "; ".join(filter(None, (interval.note, f"not compared with the best: {one.note}")))
        return replace(interval, note=note)


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


def decide(comparisons: Mapping[str, Comparison], higher_is_better: bool, level: float = LEVEL) -> dict[str, Comparison]:
    """Decide some comparisons together.

    Reading:
        A difference counts where Holm's corrected p value is below 1 - level: the more comparisons, the harder. It is not
        called at all where the clip is too short for its correlation (`intervals.Spread.undecided`): then its interval, which
        assumes to know that correlation, covers too seldom.
    """
    tested = {label: one.p_value for label, one in comparisons.items() if one.p_value is not None}
    p_values = dict(zip(tested, holm(list(tested.values())), strict=True))
    return {label: _decided(one, p_values.get(label), higher_is_better, level) for label, one in comparisons.items()}


def _decided(one: Comparison, p_value: float | None, higher_is_better: bool, level: float) -> Comparison:
    outcome: Outcome = "better" if (one.difference > 0) == higher_is_better else "worse"
    if one.difference == 0.0:
        outcome = "equal"
    elif p_value is None:
        outcome = "untested"
    elif one.short:
        outcome = "too short"
    elif p_value >= 1.0 - level:
        outcome = "as good"
    return replace(one, corrected=p_value, outcome=outcome)


def judge_against(
    results: Results, metric: str, higher_is_better: bool, dataset: str, reference: str, labels: Collection[str]
) -> dict[str, Comparison]:
    """Decide the differences of some methods to one of them, as `judge` does of all to the best.

    Returns:
        Label -> its decided comparison with the reference; methods without a number are left out.
    """
    table = pool_table(results, metric, dataset)
    having = [each for each in labels if each != reference and not math.isnan(table.values.get(each, math.nan))]
    return decide(_of_one_clip({each: _compare(table, each, reference, LEVEL) for each in having}), higher_is_better)


def _of_one_clip(comparisons: Mapping[str, Comparison]) -> dict[str, Comparison]:
    """Apply a too short clip of one comparison to all comparisons of a metric, except clear ones."""
    short = next((one.short for one in comparisons.values() if one.short), "")
    return {label: one if one.is_clear else replace(one, short=short) for label, one in comparisons.items()}


def judge(
    results: Results,
    metric: str,
    higher_is_better: bool,
    dataset: str,
    *,
    captured: float | None = None,
    own: Collection[str] = (),
    incomparable: Mapping[str, str] | None = None,
) -> Judgement:
    """Find the best method in a metric and judge every other one against it.

    Args:
        results: of all methods; those that are set aside, partial or faulty, are not ranked.
        captured: what the captured images themselves score, of a metric without truth; None where unknown.
        own: labels of one method and its variants. A method does not compete with its own ablations: the plainest represents
            all, unless these alone were measured.
        incomparable: label -> why else its number is not ranked, as it follows the name.

    Raises:
        ResultsError: no method has a value.

    Reading:
        A metric that sees no truth prefers what changes little, and blur changes least. Numbers better than those of the captured
        images are therefore not ranked; up to there a better number is nearer to them.
    """
    here = (results.table["metric"] == metric) & (results.table["dataset"] == dataset)
    if not here.any():
        raise ResultsError(f"{metric}: no values on {dataset}; score it")
    whole = without_labels(results, results.set_aside)
    table = pool_table(whole, metric, dataset)
    values = {label: value for label, value in table.values.items() if not math.isnan(value)}
    unranked = dict(incomparable or {}) | _elsewhere(whole, metric, dataset)
    sign = 1.0 if higher_is_better else -1.0
    if captured is not None:
        unranked |= {label: BEYOND for label, value in values.items() if sign * value > sign * captured}
    ranked = {label: value for label, value in values.items() if label not in unranked}
    plainest, variants = _variants(list(ranked), own)
    contenders = {label: value for label, value in ranked.items() if label not in variants}
    best = max(contenders, key=lambda label: sign * contenders[label], default="")  # of equals the first
    against_best = {each: _compare(table, each, best, LEVEL) for each in ranked if each != best}
    comparisons = decide(_of_one_clip(against_best), higher_is_better)
    worth = comparisons if best == plainest else {label: _compare(table, label, plainest, LEVEL) for label in variants}
    parts = decide({label: worth[label] for label in variants}, higher_is_better)
    return Judgement(best, comparisons, parts, unranked | results.set_aside, table_intervals(table))


def _variants(ranked: Sequence[str], own: Collection[str]) -> tuple[str, list[str]]:
    """Return the plainest of one method's labels, and the others that it represents where there are others to compete with."""
    mine = [label for label in ranked if label in own]
    plainest = min(mine, key=lambda label: ("+" in label, len(label)), default="")
    return plainest, [] if len(mine) == len(ranked) else [label for label in mine if label != plainest]


def _elsewhere(results: Results, metric: str, dataset: str) -> dict[str, str]:
    """Return the methods that lack a scene, view or frame of a metric which others have."""
    table = results.table[(results.table["metric"] == metric) & (results.table["dataset"] == dataset)]
    places = {
        label_of(str(method), str(variant)): set(zip(rows["scene"], rows["view"].fillna(""), rows["frame"], strict=True))
        for (method, variant), rows in table.groupby(["method", "variant"], sort=False)
    }
    everywhere = set().union(*places.values())
    return {label: ELSEWHERE for label, own in places.items() if own != everywhere}


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
    bounds, short = (difference - half, difference + half), spread.undecided(level)
    return Comparison(difference, *bounds, spread.p_value(), spread.note, short, spread.is_clear(level))
