"""Best method of each metric and its margin, in words and as a drawing.

The meaning of ± and bold, and what is not ranked.
"""

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

from ggvs_eval.progress import counted
from ggvs_eval.reports.model.measured import (
    MeasuredRun,
    captured_values,
    limit_by_cameras,
    shared_references,
)
from ggvs_eval.reports.model.table import (
    SHORT_MEANS,
    Cell,
    Column,
    Table,
    format_value,
    signed,
    spread_text,
)
from ggvs_eval.results import Results, without_labels
from ggvs_eval.statistics.intervals import LEVEL
from ggvs_eval.statistics.paired import (
    OUTCOMES,
    Comparison,
    Judgement,
    Outcome,
    Pair,
    Ranking,
    Standings,
    judge,
)
from ggvs_eval.statistics.pooled import pool_table

# deviations of the error, which are small too where all frames or views are equally bad
EVENNESS = ("SDT", "SDV")
COMPARABLE_DB = 1.0  # PSNR behind the best within which evenness says something of quality
HEADLINES = ("PSNR", "SSIM", "LPIPS", "TCC", "STED", "SDT", "SDV")  # those of the paper's tables
PLAIN = {
    "PSNR": "how close each frame is to the recorded one",
    "SSIM": "how similar each frame is in structure to the recorded one",
    "LPIPS": "how different each frame looks from the recorded one",
}
ALONG_PATH = "path"  # table whose reference row is the captured images
RIM = 4.0  # per cent of the drawing that stay free on either side


def judge_runs(runs: Sequence[MeasuredRun], results: Results) -> dict[str, Standings]:
    """Judge every metric of some runs, shown or not, see `ggvs_eval.statistics.paired.judge`: a
    data set's are one family.

    Reading:
        By SDT and SDV only methods within 1 dB of the best PSNR are ranked.
    """
    own_labels = frozenset().union(*(run.ours for run in runs))
    captured = captured_values(shared_references(runs))
    ranked_results = without_labels(results, results.set_aside)
    standings = {}
    for dataset in dict.fromkeys(str(name) for name in results.table["dataset"]):
        uneven = _not_comparable(ranked_results, dataset)
        rankings = []
        for note in runs[0].metrics.values():
            reasons = uneven if note.name.partition("_")[0] in EVENNESS else {}
            reference = captured.get(note.name) if note.group == ALONG_PATH else None
            rankings.append(
                Ranking(
                    metric=note.name,
                    higher_is_better=note.higher_is_better,
                    captured=reference,
                    incomparable=reasons,
                )
            )
        standings[dataset] = judge(results, rankings, dataset, own_labels)
    return standings


def describe_outcome(
    runs: Sequence[MeasuredRun], results: Results, pair: tuple[str, str, str]
) -> str:
    """Return how two methods compare in words; empty if the first is better or worse.

    Args:
        pair: metric, first and second label.
    """
    decided = judge_runs(runs, results)[runs[0].protocol.dataset].decide([Pair(*pair)])
    outcomes: list[Outcome] = [comparison.outcome for comparison in decided.values()] or [
        "untested"
    ]
    return "" if outcomes[0] in ("better", "worse") else OUTCOMES[outcomes[0]]


def _not_comparable(results: Results, dataset: str) -> dict[str, str]:
    """Return the methods of which evenness says nothing, as they are not known to be nearly as good
    as the best.
    """
    psnr_db = {
        label: value
        for label, value in pool_table(results, "PSNR", dataset).values.items()
        if not math.isnan(value)
    }
    least_db = max(psnr_db.values(), default=math.inf) - COMPARABLE_DB
    why = (
        f"is not known to be within {COMPARABLE_DB:g} dB of the best PSNR, and evenly bad frames "
        "are stable too"
    )
    return {
        label: why
        for label in dict.fromkeys(results.row_labels)
        if not psnr_db.get(label, -math.inf) >= least_db
    }


@dataclass(frozen=True)
class Leader:
    """Best number in one column of a table, that of an ablation included.

    Attributes:
        dataset: that the table is of.
        ties: other methods that cannot be distinguished from it.
        short: other methods against which the clip is too short to call it.
    """

    column: Column
    dataset: str
    name: str
    cell: Cell
    ties: tuple[str, ...]
    short: tuple[str, ...]
    judgement: Judgement


def leaders(tables: Sequence[Table], metrics: Sequence[str] = HEADLINES) -> tuple[Leader, ...]:
    """The best method of each wanted metric that has one.

    Of the first table's metrics where none is wanted that was measured.
    """
    all_leaders = [leader for table in tables for leader in _leaders_of(table)]
    headline_leaders = tuple(leader for leader in all_leaders if leader.column.name in metrics)
    return headline_leaders or tuple(all_leaders[: len(tables[0].columns)] if tables else ())


def _leaders_of(table: Table) -> list[Leader]:
    """Return one per column that ranks methods."""
    rows = {row.label: row for row in table.rows if row.label}
    leaders_found = []
    for at, column in enumerate(table.columns):
        judgement = table.judgements.get(column.name)
        if judgement and judgement.best:
            best, method = rows[judgement.top], judgement.comparisons.get(judgement.top)
            ties, short = [*judgement.having("as good", "equal")], [*judgement.having("too short")]
            # an ablation has the better number, maybe by chance
            if method and method.outcome != "better":
                (short if method.outcome == "too short" else ties).insert(0, judgement.best)
            ties, short = ([rows[label].name for label in labels] for labels in (ties, short))
            leaders_found.append(
                Leader(
                    column=column,
                    dataset=table.dataset,
                    name=best.name,
                    cell=best.cells[at],
                    ties=tuple(ties),
                    short=tuple(short),
                    judgement=judgement,
                )
            )
    return leaders_found


def certainty_captions(
    judgements: Mapping[str, Judgement], names: Mapping[str, str], set_aside: Collection[str]
) -> tuple[list[str], list[str]]:
    """Write the meaning of ± and bold for a table's caption, and for its note what is not ranked or
    has no interval.

    Args:
        judgements: metric -> which methods are better than which.
        names: label -> name to show.
        set_aside: labels of partial and faulty methods, which other sentences are about.
    """
    level = f"{100 * LEVEL:.0f} %"
    bounded = [
        interval
        for judgement in judgements.values()
        for interval in judgement.intervals.values()
        if interval.low is not None
    ]
    conditions = dict.fromkeys(
        f", given {', '.join(interval.conditions)}" for interval in bounded if interval.conditions
    )
    condition = "".join(conditions)
    brief = [f"±: {level} interval."] if bounded else []
    captions = (
        [f"Intervals are by the correlation over time that each clip allows{condition}."]
        if bounded
        else []
    )
    captions += [SHORT_MEANS] if any(interval.is_short for interval in bounded) else []
    if any(judgement.marked for judgement in judgements.values()):
        brief.append(
            f"Bold: best, or not significantly worse (paired, {level} for all methods and metrics "
            f"together)."
        )
    # beginning and end of a sentence -> what is between them
    said: dict[tuple[str, str], list[str]] = defaultdict(list)
    for metric, judgement in judgements.items():
        if judgement.rivals and not judgement.marked:
            why = judgement.undecided or "no method is significantly worse than the best"
            said["Nothing is bold in ", f": {why}."].append(metric)
    for metric, judgement in judgements.items():
        if refusal := next(
            (interval.note for interval in judgement.intervals.values() if interval.low is None), ""
        ):
            said["No interval for ", f": {refusal}."].append(metric)
    for metric, judgement in judgements.items():
        for label, why in judgement.unranked.items():
            if label not in set_aside:
                said["Not ranked: ", f", which {why}."].append(
                    f"{names.get(label, label)} in {metric}"
                )
    return brief, captions + [
        f"{beginning}{', '.join(gap)}{end}" for (beginning, end), gap in said.items()
    ]


@dataclass(frozen=True)
class Contender:
    """One method in the headline metric.

    Attributes:
        place: of the value in the drawing, per cent from the left; None if it is not finite.
        span: ends of the interval in the same way; None if there is none.
        worth: of a variant of GGVS, its difference to the full method in words; empty otherwise.
    """

    label: str
    name: str
    cell: Cell
    place: float | None
    span: tuple[float, float] | None
    worth: str = ""


@dataclass(frozen=True)
class Verdict:
    """The answer of a group of runs.

    Attributes:
        headline: who is best, or why none can be named, and which methods are set aside.
        margin: by how much, with its interval; or what to do, where nothing is ranked.
        column: the metric that this is in; None if nothing is ranked.
        meaning: what it measures, in plain words.
        contenders: every method that competes, the best first; of GGVS the full method, unless only
            its variants were measured.
        parts: variants of GGVS, with what each lacks or adds.
        others: name of a method -> the other metrics that it alone is best in.
        tied: the other metrics in which no winner can be named.
    """

    headline: str
    margin: str
    column: Column | None = None
    meaning: str = ""
    contenders: tuple[Contender, ...] = ()
    parts: tuple[Contender, ...] = ()
    others: dict[str, list[str]] = field(default_factory=dict)
    tied: tuple[str, ...] = ()

    def shown(self, run: MeasuredRun) -> tuple[str, ...]:
        """Methods whose pictures represent a run: the best with GGVS (online), or with the
        runner-up if GGVS is the best.
        """
        labels = [
            contender.label
            for contender in (*self.contenders, *self.parts)
            if contender.label in run.pictured
        ]
        beside = (
            [label for label in labels[1:] if label in run.ours]
            if labels and labels[0] not in run.ours
            else []
        )
        return tuple(dict.fromkeys([*labels[:1], *beside, *labels[1:]]))[:2]


def evaluate_verdict(
    runs: Sequence[MeasuredRun], results: Results, tables: Sequence[Table]
) -> Verdict:
    """State the best method in the first headline metric, or why nothing is ranked, and the remedy.

    Reading:
        The paper names no single measure of quality. The first measured one of its tables is the
        headline (PSNR, if it was), and the leaders of the others are stated with it. All of it is
        read from the judgements of the tables.
    """
    all_leaders, causes, remedies = leaders(tables), *_set_aside(runs, results)
    if not all_leaders:
        absences = [
            f"{metric} was not computed, {why}" for metric, why in results.not_computed.items()
        ]
        causes = causes or absences[:1] or ["no metric was measured; score the run"]
        return Verdict(f"Nothing is ranked: {'; '.join(causes)}", " ".join(remedies))
    first = min(
        all_leaders,
        key=lambda leader: (
            HEADLINES.index(leader.column.name)
            if leader.column.name in HEADLINES
            else len(HEADLINES)
        ),
    )
    table = next(
        candidate
        for candidate in tables
        if candidate.dataset == first.dataset and first.column in candidate.columns
    )
    judgement, at = first.judgement, table.columns.index(first.column)
    rows = {row.label: row for row in table.rows if row.label}
    sign = 1.0 if first.column.higher_is_better else -1.0
    ranked = sorted(
        (judgement.best, *judgement.comparisons),
        key=lambda label: -sign * cast(float, rows[label].cells[at].value),
    )
    places = _Scale([rows[label].cells[at] for label in ranked])
    decimals = runs[0].metrics[first.column.name].decimals
    contenders: list[Contender] = []
    parts: list[Contender] = []
    for label in ranked:
        cell = rows[label].cells[at]
        worth = _worth(judgement.variants[label], decimals) if label in judgement.variants else ""
        contender = Contender(
            label=label,
            name=rows[label].name,
            cell=cell,
            place=places.at(cell.value),
            span=places.span(cell),
            worth=worth,
        )
        (parts if label in judgement.variants else contenders).append(contender)
    headline, margin = _words(first, judgement, contenders, runs, results)
    other_leaders: dict[str, list[str]] = {}
    for leader in all_leaders:
        if (
            leader is not first
            and leader.judgement.rivals
            and not {*judgement.rivals} & leader.judgement.unranked.keys()
        ):
            other_leaders.setdefault(leader.name if leader.judgement.winner else "", []).append(
                leader.column.name
            )
    tied = tuple(other_leaders.pop("", ()))
    meaning = PLAIN.get(first.column.name, first.column.describe)
    headline = " ".join(filter(None, [limit_by_cameras(runs), headline]))
    headline, margin = (
        "; ".join([headline, *causes, *_suspicions(runs, results)]),
        " ".join(filter(None, (f"{margin}.", *remedies))),
    )
    return Verdict(
        headline=headline,
        margin=margin,
        column=first.column,
        meaning=meaning,
        contenders=tuple(contenders),
        parts=tuple(parts),
        others=other_leaders,
        tied=tied,
    )


def _set_aside(runs: Sequence[MeasuredRun], results: Results) -> tuple[list[str], list[str]]:
    """Return the methods that are not ranked, in words, and what to do about each."""
    names = {label: run.names.get(label, label) for run in runs for label in run.labels}
    reasons = {label: results.set_aside[label] for label in names if label in results.set_aside}
    faults = {fault.label: fault for fault in reversed(results.faults) if fault.is_certain}
    remedies: dict[str, list[str]] = {}  # what to do -> with which methods
    for label in reasons:
        if (
            todo := faults[label].remedy
            if label in faults
            else "Render the missing frames and score again."
        ):
            remedies.setdefault(f"{todo[0].lower()}{todo[1:]}", []).append(names[label])
    return [f"{names[label]} {why}" for label, why in reasons.items()], [
        f"{', '.join(group)}: {todo}" for todo, group in remedies.items()
    ]


def _suspicions(runs: Sequence[MeasuredRun], results: Results) -> list[str]:
    """Return likely faults of methods that are ranked all the same, one of each, in words."""
    names = {label: run.names.get(label, label) for run in runs for label in run.labels}
    likely = {fault.label: fault for fault in reversed(results.faults) if not fault.is_certain}
    ranked = [label for label in names if label in likely and label not in results.set_aside]
    return [f"{names[label]} {likely[label].words} (likely)" for label in ranked]


def _worth(comparison: Comparison, decimals: int | None) -> str:
    """Difference of a variant to the method itself, with its interval if there is one."""
    worth = signed(comparison.difference, decimals)
    half = None if comparison.high is None else comparison.high - comparison.difference
    return (
        worth
        if half is None
        else f"{worth} {spread_text(comparison.difference, half, decimals, bool(comparison.short))}"
    )


def _words(
    leader: Leader,
    judgement: Judgement,
    contenders: Sequence[Contender],
    runs: Sequence[MeasuredRun],
    results: Results,
) -> tuple[str, str]:
    best, unit = contenders[0], f" {leader.column.unit}" if leader.column.unit else ""
    decimals = runs[0].metrics[leader.column.name].decimals
    if not judgement.rivals:
        number = f"{best.cell.shown} {best.cell.spread}".strip() + unit
        if not judgement.unranked:
            return f"{best.name} is the only method measured", number
        if judgement.unranked.keys() <= results.set_aside.keys():
            return f"Only {best.name} is ranked", f"{best.name} has {number}"
        return (
            "No winner can be named",
            f"{best.name} has {number}; the others were measured on other scenes, views or frames",
        )
    tied = judgement.having("as good", "equal")
    rival = next(
        (
            contender
            for contender in contenders[1:]
            if contender.label in (*tied, *judgement.having("too short"))
        ),
        contenders[1],
    )
    comparison = judgement.comparisons[rival.label]
    if comparison.outcome == "equal":
        return f"{best.name} and {rival.name} are equal", f"{best.cell.shown}{unit} each"
    second = f"“{rival.name}”" if "," in rival.name else rival.name
    by = f"{format_value(abs(comparison.difference), decimals)}{unit}"
    interval = _interval(comparison, bool(leader.column.higher_is_better), decimals, unit)
    if judgement.undecided:
        frames, views = runs[0].protocol.frames.count, len(runs[0].protocol.views.test)
        looked_at = f"{counted(frames, 'frame')} of {counted(views, 'view')}"
        return (
            f"No winner can be named from {looked_at}",
            f"{best.name} is {by} ahead of {second}; {judgement.undecided}",
        )
    if tied:
        rivals = rival.name if len(tied) == 1 else f"{len(tied)} others"
        return (
            f"{best.name} and {rivals} tie",
            f"{by} between {best.name} and {second} is not significant{interval}",
        )
    return f"{best.name} is best", f"{by} ahead of {second}, the next best{interval}"


def _interval(
    comparison: Comparison, higher_is_better: bool, decimals: int | None, unit: str
) -> str:
    """Return the bounds of the best method's margin."""
    if comparison.low is None or comparison.high is None:
        return ""
    low, high = (
        (-comparison.high, -comparison.low)
        if higher_is_better
        else (comparison.low, comparison.high)
    )
    bounds = [format_value(bound, decimals).replace("-", "−") for bound in (low, high)]
    return f" ({100 * LEVEL:.0f}\N{NO-BREAK SPACE}% interval {bounds[0]} to {bounds[1]}{unit})"


class _Scale:
    """Places in a drawing that holds all finite values and intervals."""

    def __init__(self, cells: Sequence[Cell]) -> None:
        numbers = [
            number
            for cell in cells
            for number in (cell.value, cell.low, cell.high)
            if number is not None
        ]
        finite = [number for number in numbers if math.isfinite(number)] or [0.0]
        self.low, self.size = min(finite), max(finite) - min(finite)

    def at(self, value: float | None) -> float | None:
        """Per cent from the left."""
        if value is None or not math.isfinite(value):
            return None
        return round(
            RIM + (100.0 - 2.0 * RIM) * ((value - self.low) / self.size if self.size else 0.5), 2
        )

    def span(self, cell: Cell) -> tuple[float, float] | None:
        """Return both ends of an interval."""
        ends = self.at(cell.low), self.at(cell.high)
        return None if ends[0] is None or ends[1] is None else (ends[0], ends[1])
