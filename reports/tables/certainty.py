"""Certainty of the numbers of a table: intervals, the best method, its ties, and methods that are not ranked."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ggvs_eval.reports.model.measured import without_labels
from ggvs_eval.reports.model.metric_note import MetricNote
from ggvs_eval.results import Results, label_of
from ggvs_eval.statistics.intervals import LEVEL, Interval, intervals
from ggvs_eval.statistics.paired import Standing, rank_methods

BEYOND = "better than the captured images, as blur is"
ELSEWHERE = "measured on other views or frames than the others"


@dataclass(frozen=True)
class Certainty:
    """Statistical certainty of one metric's numbers.

    Attributes:
        intervals: label -> interval, or why there is none.
        standing: who is best and who ties, of those that are ranked; None where there are fewer than two.
        unranked: label -> why its number is not ranked.
    """

    intervals: Mapping[str, Interval]
    standing: Standing | None
    unranked: Mapping[str, str]

    @property
    def told(self) -> frozenset[str] | None:
        """Labels of the best and its ties; None where none could be compared with the best."""
        if self.standing is None or (self.standing.comparisons and not self.standing.p_values):
            return None
        return self.standing.ties

    @property
    def is_short(self) -> bool:
        """Whether the clip is too short to name a winner over some method."""
        return self.standing is not None and bool(self.standing.short)

    @property
    def marked(self) -> frozenset[str] | None:
        """`told`; but all where the clip is too short, so that none is marked: a row far behind is no tie because of that."""
        if self.standing is not None and self.is_short:
            return self.standing.best | self.standing.comparisons.keys()
        return self.told

    @property
    def undecided(self) -> str:
        """Reason why no method is named as the best; empty where one is, or ties are."""
        if self.standing is None:
            return "the others are not ranked" if self.unranked else ""
        untested = [f"{label}: {why}" for label, why in self.standing.untested.items()]
        if untested and not self.standing.p_values:
            return f"nothing could be compared ({next(iter(self.standing.untested.values()))})"
        return self.standing.short or (f"not compared with {untested[0]}" if untested else "")

    @property
    def refusal(self) -> str:
        """Reason why some method has no interval; empty where all have one."""
        return next((interval.note for interval in self.intervals.values() if interval.low is None), "")

    def interval(self, label: str) -> Interval | None:
        """Interval of a method; its note also says why it was not compared with the best."""
        interval = self.intervals.get(label)
        why = "" if self.standing is None else self.standing.untested.get(label, "")
        if interval is None or not why or why == interval.note:
            return interval
        note = "; ".join(filter(None, (interval.note, f"not compared with the best: {why}")))
        return Interval(interval.value, interval.low, interval.high, note)


def assess(note: MetricNote, results: Results, dataset: str, captured: float | None = None) -> Certainty:
    """Find intervals and standing of one metric.

    Args:
        results: of all methods; those that are set aside, partial or faulty, are left out.
        captured: what the captured images themselves score, of a metric without truth; None where unknown.

    Reading:
        A metric that sees no truth prefers what changes little, and blur changes least. Numbers better than those of the captured
        images are therefore shown and not ranked; up to there a better number is nearer to them.
    """
    whole = without_labels(results, results.set_aside)
    interval_of = intervals(whole, note.name, dataset)
    values = {label: one.value for label, one in interval_of.items() if not math.isnan(one.value)}
    unranked = _elsewhere(whole, note.name, dataset)
    if captured is not None:
        sign = 1.0 if note.higher_is_better else -1.0
        unranked |= {label: BEYOND for label, value in values.items() if sign * value > sign * captured}
    several = len(values.keys() - unranked.keys()) > 1
    ranked = without_labels(whole, unranked)
    standing = rank_methods(ranked, note.name, note.higher_is_better, dataset) if several else None
    return Certainty(interval_of, standing, unranked)


def _elsewhere(results: Results, metric: str, dataset: str) -> dict[str, str]:
    """Methods that lack a scene, view or frame of a metric which others have."""
    table = results.table[(results.table["metric"] == metric) & (results.table["dataset"] == dataset)]
    places = {
        label_of(str(method), str(variant)): set(zip(rows["scene"], rows["view"].fillna(""), rows["frame"], strict=True))
        for (method, variant), rows in table.groupby(["method", "variant"], sort=False)
    }
    everywhere = set().union(*places.values())
    return {label: ELSEWHERE for label, own in places.items() if own != everywhere}


def certainty_captions(
    certain: Mapping[str, Certainty], names: Mapping[str, str], undifferentiated: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Write the meaning of ± and bold for a table's caption, and for its note what is not ranked or has no interval.

    Args:
        certain: metric -> certainty.
        names: label -> name to show.
        undifferentiated: metrics in which no method is distinguished, so that nothing is bold.
    """
    level = f"{100 * LEVEL:.0f} %"
    bounded = [one for certainty in certain.values() for one in certainty.intervals.values() if one.low is not None]
    given = "".join(f", {note}" for note in dict.fromkeys(interval.note.partition(";")[0] for interval in bounded) if note)
    brief = [f"±: {level} interval."] if bounded else []
    captions = [f"Intervals are by the correlation over time that each clip allows{given}."] if bounded else []
    ranked = [certainty for certainty in certain.values() if certainty.standing]
    if any(certainty.told for certainty in ranked):
        brief.append(f"Bold: best, and what cannot be told from it (paired, {level}).")
    by_digits = [metric for metric, certainty in certain.items() if certainty.standing and certainty.told is None]
    if by_digits:
        captions.append(
            f"Bold in {', '.join(by_digits)}: best to the printed digits, nothing could be compared, so nobody is the winner."
        )
    equal = [metric for metric in undifferentiated if metric not in certain or not certain[metric].is_short]
    if equal:
        captions.append(f"Nothing is bold in {', '.join(equal)}: no method can be told from the best.")
    said: dict[str, list[str]] = defaultdict(list)  # sentence with a gap -> what fills it
    for metric, certainty in certain.items():
        if certainty.undecided and metric not in by_digits:
            unmarked = ", so nothing is bold" if certainty.is_short else ""
            said[f"No winner in {{}}{unmarked}: {certainty.undecided}."].append(metric)
    for metric, certainty in certain.items():
        if certainty.refusal:
            said[f"No interval for {{}}: {certainty.refusal}."].append(metric)
    for metric, certainty in certain.items():
        for label, why in certainty.unranked.items():
            said[f"Not ranked: {{}}, {why}."].append(f"{names.get(label, label)} in {metric}")
    return brief, captions + [sentence.replace("{}", ", ".join(gap), 1) for sentence, gap in said.items()]
