"""Judgement of methods: paired comparisons on the same views and frames, and what may be said of
the best from them.
"""

import math
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, TypeVar

from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results, label_of, without_labels
from ggvs_eval.statistics.intervals import (
    LEVEL,
    Interval,
    Spread,
    measure_spread,
    table_intervals,
    typical_worth,
)
from ggvs_eval.statistics.pooled import PooledTable, pool_table

# Of the first of two methods. Too short: the clip allows no answer, which is not the same as "as
# good".
Outcome = Literal["better", "worse", "as good", "equal", "too short", "untested"]
OUTCOMES: Mapping[Outcome, str] = {
    **{
        "better": "better",
        "worse": "worse",
        "as good": "not significantly different",
        "equal": "equal",
    },
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
        note: what is taken as given (``given this scene, these 3 views``), or why there is no
            interval.
        short: why the clip is too short to call it, regardless of the p value; empty if it is not,
            or before it was decided.
        corrected: p value after Holm's correction for the comparisons that it was decided with.
        outcome: of the first method; ``untested`` before it was decided, see `decide`.
        higher_is_better: direction of the metric.
        spread: the difference with its random error; None where `low` is.
    """

    difference: float
    low: float | None
    high: float | None
    p_value: float | None
    note: str
    short: str = ""
    corrected: float | None = None
    outcome: Outcome = "untested"
    higher_is_better: bool = True
    spread: Spread | None = field(default=None, compare=False)

    @property
    def is_ahead(self) -> bool:
        """True if the first has the better number, be it by chance."""
        return self.difference != 0.0 and (self.difference > 0.0) == self.higher_is_better

    @property
    def reversed(self) -> "Comparison":
        """The same, second minus first."""
        outcome: Outcome = {"better": "worse", "worse": "better"}.get(self.outcome, self.outcome)  # type: ignore[assignment]
        low = None if self.high is None else -self.high
        high = None if self.low is None else -self.low
        return replace(self, difference=-self.difference, low=low, high=high, outcome=outcome)


class Pair(NamedTuple):
    """Labels of two methods that are compared in a metric."""

    metric: str
    first: str
    second: str


@dataclass(frozen=True)
class Ranking:
    """How a metric of a table ranks its methods.

    Attributes:
        captured: what the captured images themselves score, of a metric without truth; None where
            unknown.
        incomparable: label -> why its number is not ranked, as it follows the name.
    """

    metric: str
    higher_is_better: bool
    captured: float | None = None
    incomparable: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Judgement:
    """Standing of the methods in one metric on one data set: the one place from which reports take
    who is better.

    Attributes:
        best: label of the best number among the contenders; empty if nothing is ranked.
        plainest: of one method's labels the one that represents them; empty if there is none.
        comparisons: label -> its decided difference to the best, for every other method that is
            ranked.
        variants: ranked methods that do not compete, since one of their kind competes for all ->
            their difference to that one; the marks of a table count them.
        unranked: label -> why its number is not ranked, as it follows the name.
        intervals: label -> interval of its number, or why there is none; not of methods that are
            set aside.
    """

    best: str
    comparisons: Mapping[str, Comparison]
    variants: Mapping[str, Comparison]
    unranked: Mapping[str, str]
    intervals: Mapping[str, Interval]
    plainest: str = ""

    def decided(self, metric: str, family: Mapping["Pair", Comparison]) -> "Judgement":
        """Return the same with what was decided of its comparisons."""
        comparisons = {label: family[Pair(metric, label, self.best)] for label in self.comparisons}
        variants = {label: family[Pair(metric, label, self.plainest)] for label in self.variants}
        return replace(self, comparisons=comparisons, variants=variants)

    @property
    def rivals(self) -> tuple[str, ...]:
        """Contenders but the best."""
        return tuple(label for label in self.comparisons if label not in self.variants)

    def having(self, *outcomes: Outcome) -> tuple[str, ...]:
        """Rivals of these outcomes against the best."""
        return tuple(label for label in self.rivals if self.comparisons[label].outcome in outcomes)

    @property
    def top(self) -> str:
        """Label of the best number of all, those of variants included, which do not compete for
        `best`.
        """
        ahead = {
            label: abs(self.comparisons[label].difference)
            for label in self.variants
            if self.comparisons[label].is_ahead
        }
        return max(ahead, key=lambda label: ahead[label], default=self.best)

    @property
    def winner(self) -> str:
        """Label of the best number where every rival is worse, and its own method too if it is a
        variant; else empty.
        """
        if not self.rivals or len(self.having("worse")) < len(self.rivals):
            return ""
        return (
            self.top
            if self.top == self.best or self.comparisons[self.top].outcome == "better"
            else ""
        )

    @property
    def undecided(self) -> str:
        """Return why no winner is named although no rival is as good: a short clip, no test, no
        rival.
        """
        if not self.rivals:
            return "the others are not ranked" if self.unranked else ""
        short, untested = self.having("too short"), self.having("untested")
        if short:
            return self.comparisons[short[0]].short
        if len(untested) == len(self.rivals):
            return f"nothing could be compared ({self.comparisons[untested[0]].note})"
        return (
            f"not compared with {untested[0]}: {self.comparisons[untested[0]].note}"
            if untested
            else ""
        )

    @property
    def marked(self) -> frozenset[str]:
        """Labels of the best and of what is not worse.

        None if that is undecided, or would be every method.

        Reading:
            A variant that the clip is too short to call is not known to be worse. Where a variant
            is better, its method is worse.
        """
        if self.undecided:
            return frozenset()
        level = {
            label
            for label, comparison in self.comparisons.items()
            if comparison.outcome in NOT_WORSE
        }
        level |= {label for label in self.variants if self.comparisons[label].outcome != "worse"}
        if not any(self.comparisons[label].outcome == "better" for label in self.variants):
            level.add(self.best)
        return frozenset(level) if len(level) <= len(self.comparisons) else frozenset()

    def interval(self, label: str) -> Interval | None:
        """Return the interval of a method.

        Its note also says why it was not compared with the best.
        """
        interval, comparison = self.intervals.get(label), self.comparisons.get(label)
        if (
            interval is None
            or comparison is None
            or comparison.p_value is not None
            or comparison.note == interval.note
        ):
            return interval
        note = "; ".join(
            filter(None, (interval.note, f"not compared with the best: {comparison.note}"))
        )
        return replace(interval, note=note)


@dataclass(frozen=True)
class Standings:
    """Judgements of one table on one data set, whose comparisons were decided together.

    Attributes:
        judgements: metric -> which methods are better than which.
        family: comparisons that the table makes: of every method with the best, and of the variants
            of a method with it, in all metrics.
    """

    results: Results
    dataset: str
    rankings: Mapping[str, Ranking]
    judgements: Mapping[str, Judgement]
    family: Mapping[Pair, Comparison]

    def decide(self, pairs: Iterable[Pair]) -> dict[Pair, Comparison]:
        """Decide some pairs as the table does.

        Returns:
            Pair -> its comparison; none of a method without a number.

        Reading:
            What the table has said already stays so. Further comparisons are decided together with
            all of the table, as if it had made them too.
        """
        comparisons: dict[Pair, Comparison] = {}
        further: dict[Pair, Comparison] = {}
        for pair in pairs:
            turned = Pair(pair.metric, pair.second, pair.first)
            if pair in self.family:
                comparisons[pair] = self.family[pair]
            elif turned in self.family:
                comparisons[pair] = self.family[turned].reversed
            else:
                further |= self._compare(pair)
        everything = decide({**self.family, **further}) if further else {}
        return comparisons | {pair: everything[pair] for pair in further}

    def _compare(self, pair: Pair) -> dict[Pair, Comparison]:
        table = pool_table(self.results, pair.metric, self.dataset)
        if any(
            math.isnan(table.values.get(label, math.nan)) for label in (pair.first, pair.second)
        ):
            return {}
        return {
            pair: _compare(
                table, pair.first, pair.second, self.rankings[pair.metric].higher_is_better
            )
        }


def compare(
    results: Results,
    metric: str,
    first: str,
    second: str,
    dataset: str,
    higher_is_better: bool = True,
) -> Comparison:
    """Compare two methods on the same views and frames.

    Args:
        first: label, ``method`` or ``method+variant``.
    """
    table = pool_table(results, metric, dataset)
    for label in (first, second):
        if label not in table.values:
            raise ResultsError(
                f"{metric} of {label}: no values on {dataset}; there are "
                f"{', '.join(table.values) or 'none'}"
            )
    return _compare(table, first, second, higher_is_better)


Key = TypeVar("Key", bound=Hashable)


def decide(comparisons: Mapping[Key, Comparison]) -> dict[Key, Comparison]:
    """Decide some comparisons together: those of one table, over all its metrics, methods and
    variants.

    Reading:
        A difference counts where Holm's corrected p value is below 0.05: the more comparisons, the
        harder. It is not called at all where the clip is too short for its correlation
        (`intervals.Spread.too_short`): then its interval, which assumes to know that correlation,
        covers too seldom. Of equal methods any is called better in at most 5 % of tables and of
        pairs (`benchmarks/interval_coverage.py`).
    """
    tested = {
        key: comparison for key, comparison in comparisons.items() if comparison.spread is not None
    }
    p_values = holm([comparison.p_value or 0.0 for comparison in tested.values()])
    corrected = dict(zip(tested, p_values, strict=True))
    worth = typical_worth(
        [comparison.spread for comparison in tested.values() if comparison.spread is not None]
    )
    tail = (1.0 - LEVEL) / max(len(tested), 1)
    decided = {}
    for key, comparison in comparisons.items():
        short = "" if comparison.spread is None else comparison.spread.too_short(tail, worth)
        p_value = corrected.get(key)
        outcome = _outcome(comparison.difference, p_value, short, comparison.higher_is_better)
        decided[key] = replace(comparison, corrected=p_value, short=short, outcome=outcome)
    return decided


def _outcome(
    difference: float, p_value: float | None, short: str, higher_is_better: bool
) -> Outcome:
    if difference == 0.0:
        return "equal"
    if p_value is None:
        return "untested"
    if short:
        return "too short"
    if p_value >= 1.0 - LEVEL:
        return "as good"
    return "better" if (difference > 0) == higher_is_better else "worse"


def judge(
    results: Results, rankings: Sequence[Ranking], dataset: str, own_labels: Collection[str] = ()
) -> Standings:
    """Find the best method in each metric of a table and judge every other one against it.

    Args:
        results: of all methods; those that are set aside, partial or faulty, are not ranked.
        rankings: of the metrics of the table, shown or not: they are one family.
        own_labels: labels of one method and its variants. A method does not compete with its own
            ablations: the plainest represents all, unless these alone were measured.

    Returns:
        Judgements of the metrics in which any method has a number.

    Reading:
        A metric that sees no truth prefers what changes little, and blur changes least. Numbers
        better than those of the captured images are therefore not ranked; up to there a better
        number is nearer to them.
    """
    complete_results = without_labels(results, results.set_aside)
    judgements: dict[str, Judgement] = {}
    pairs: dict[Pair, Comparison] = {}
    for ranking in rankings:
        metric, sign = ranking.metric, 1.0 if ranking.higher_is_better else -1.0
        rows = results.table[
            (results.table["metric"] == metric) & (results.table["dataset"] == dataset)
        ]
        if rows["value"].isna().all():
            continue
        table = pool_table(complete_results, metric, dataset)
        values = {label: value for label, value in table.values.items() if not math.isnan(value)}
        unranked = {**ranking.incomparable, **_elsewhere(complete_results, metric, dataset)}
        if ranking.captured is not None:
            unranked |= {
                label: BEYOND
                for label, value in values.items()
                if sign * value > sign * ranking.captured
            }
        ranked = [label for label in values if label not in unranked]
        plainest, variants = _variants(ranked, own_labels)
        contenders = [label for label in ranked if label not in variants]
        # of equals the first
        best = max(contenders, key=lambda label: sign * values[label], default="")
        new_pairs = [Pair(metric, label, best) for label in ranked if label != best]
        new_pairs += [Pair(metric, label, plainest) for label in variants]
        pairs |= {
            pair: _compare(table, pair.first, pair.second, ranking.higher_is_better)
            for pair in new_pairs
        }
        judgements[metric] = Judgement(
            best=best,
            plainest=plainest,
            comparisons={
                label: pairs[Pair(metric, label, best)] for label in ranked if label != best
            },
            variants={label: pairs[Pair(metric, label, plainest)] for label in variants},
            unranked=unranked | results.set_aside,
            intervals=table_intervals(table),
        )
    family = decide(pairs)
    decided = {
        metric: judgement.decided(metric, family) for metric, judgement in judgements.items()
    }
    return Standings(
        results=results,
        dataset=dataset,
        rankings={ranking.metric: ranking for ranking in rankings},
        judgements=decided,
        family=family,
    )


def _variants(ranked: Sequence[str], own_labels: Collection[str]) -> tuple[str, list[str]]:
    """Return the plainest of one method's labels, and the others that it represents where there are
    others to compete with.
    """
    labels = [label for label in ranked if label in own_labels]
    plainest = min(labels, key=lambda label: ("+" in label, len(label)), default="")
    return plainest, [] if len(labels) == len(ranked) else [
        label for label in labels if label != plainest
    ]


def _elsewhere(results: Results, metric: str, dataset: str) -> dict[str, str]:
    """Return the methods that lack a scene, view or frame of a metric which others have."""
    table = results.table[
        (results.table["metric"] == metric) & (results.table["dataset"] == dataset)
    ]
    places = {
        label_of(str(method), str(variant)): set(
            zip(rows["scene"], rows["view"].fillna(""), rows["frame"], strict=True)
        )
        for (method, variant), rows in table.groupby(["method", "variant"], sort=False)
    }
    everywhere = set().union(*places.values())
    return {label: ELSEWHERE for label, cells in places.items() if cells != everywhere}


def holm(p_values: Sequence[float]) -> list[float]:
    """P values corrected for their number so that one false alarm among all is as rare as it was in
    one (Holm 1979).

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


def _compare(table: PooledTable, first: str, second: str, higher_is_better: bool) -> Comparison:
    """Take the difference first, so that what moves both methods alike cancels."""
    values = table.values[first], table.values[second]
    # two infinite numbers are equal too
    difference = 0.0 if values[0] == values[1] else values[0] - values[1]
    try:
        minuends, subtrahends = table.scenes_of(first), table.scenes_of(second)
        if [scene.scene for scene in minuends] != [scene.scene for scene in subtrahends]:
            raise ResultsError(
                f"{first} and {second} were not measured on the same scenes; score both on each"
            )
        pairs = zip(minuends, subtrahends, strict=True)
        spread = measure_spread([minuend.minus(subtrahend) for minuend, subtrahend in pairs])
    except ResultsError as refusal:
        return Comparison(
            difference=difference,
            low=None,
            high=None,
            p_value=None,
            note=str(refusal),
            higher_is_better=higher_is_better,
        )
    half = spread.half_width()
    return Comparison(
        difference=difference,
        low=difference - half,
        high=difference + half,
        p_value=spread.p_value(),
        note=spread.note,
        higher_is_better=higher_is_better,
        spread=spread,
    )
