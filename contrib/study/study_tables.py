"""Tables of a metric study as Markdown: correlations, the least strength that is detected, and the
blind spots of each metric.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from ggvs_eval.contrib.study.metric_study import Study, answered_metrics

BLANK = "–"
Answer = Mapping[str, Any]


def correlation_table(study: Study, metrics: Sequence[str] | None = None) -> str:
    """Rank correlation of each metric with each degradation, with its interval where that is wider
    than a hundredth.
    """
    return _table(study, metrics, _correlation)


def sensitivity_table(study: Study, metrics: Sequence[str] | None = None) -> str:
    """Return the least strength that each metric distinguishes from the original, with the unit
    next to the degradation.
    """
    return _table(study, metrics, lambda answer: _number(answer["least_strength"]), with_units=True)


def verdict_table(studies: Sequence[Study], metrics: Sequence[str] | None = None) -> str:
    """Degradations that each metric detects, misses and rewards.

    A separate column for those on which studies disagree.
    """
    heads = {"sees": "worse with strength", "blind": "blind to", "rewards": "better with strength"}
    heads |= (
        {"disputed": "depends on the capture"}
        if len(studies) > 1
        else {"unclear": "one clip: unclear"}
    )
    verdicts = [
        (metric, _verdicts(studies, metric)) for metric in metrics or answered_metrics(studies)
    ]
    columns = [
        head
        for head in heads
        if head != "unclear" or any("unclear" in verdict_of.values() for _, verdict_of in verdicts)
    ]
    lines = [
        f"| metric | {' | '.join(heads[head] for head in columns)} |",
        "| --- |" + " --- |" * len(columns),
    ]
    for metric, verdict_of in verdicts:
        cells = [
            ", ".join(ladder for ladder, verdict in verdict_of.items() if verdict == head) or BLANK
            for head in columns
        ]
        lines.append(f"| `{metric}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def by_ladder_table(studies: Sequence[Study]) -> str:
    """Return each degradation with the number of metrics that see it, and the names of those that
    do not.
    """
    verdicts = {metric: _verdicts(studies, metric) for metric in answered_metrics(studies)}
    lines = [
        "| degradation | detected by | missed by | better with strength | depends on the capture |"
    ]
    lines.append("| --- | ---: | --- | --- | --- |")
    for ladder in dict.fromkeys(name for study in studies for name in study["ladders"]):
        verdict_of = {
            metric: of_metric[ladder]
            for metric, of_metric in verdicts.items()
            if ladder in of_metric
        }
        seeing = sum(verdict == "sees" for verdict in verdict_of.values())
        cells = [
            ", ".join(f"`{metric}`" for metric, verdict in verdict_of.items() if verdict == kind)
            or BLANK
            for kind in ("blind", "rewards", "disputed")
        ]
        lines.append(f"| {ladder} | {seeing} of {len(verdict_of)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _verdicts(studies: Sequence[Study], metric: str) -> dict[str, str]:
    """Degradation -> verdict of all studies that have one, or ``disputed``."""
    verdicts: dict[str, set[str]] = {}
    for study in studies:
        for ladder, answers in study["answers"].items():
            if metric in answers:
                verdicts.setdefault(ladder, set()).add(answers[metric]["verdict"])
    return {
        ladder: answers.pop() if len(answers) == 1 else "disputed"
        for ladder, answers in verdicts.items()
    }


def ladder_table(study: Study) -> str:
    """Return the degradations, their strengths and units."""
    lines = [
        "| degradation | strengths | unit | description |",
        "| --- | --- | --- | --- |",
    ]
    for name, ladder in study["ladders"].items():
        strengths = ", ".join(f"{strength:g}" for strength in ladder["strengths"])
        lines.append(f"| {name} | {strengths} | {ladder['unit']} | {ladder['describe']} |")
    return "\n".join(lines)


def absence_list(study: Study) -> str:
    """Return the metrics that have no number on any degradation, each with its reason."""
    answered = set(answered_metrics([study]))
    reasons: dict[str, str] = {}
    for of_ladder in study["not_computed"].values():
        reasons |= {metric: why for metric, why in of_ladder.items() if metric not in answered}
    return "\n".join(f"- `{metric}` not computed: {why}" for metric, why in reasons.items())


def study_text(study: Study) -> str:
    """Return all tables of a study."""
    parts = {
        f"Metric study of {', '.join(study['captures'])}": f"{study['takes']} clips.",
        "Degradations": ladder_table(study),
        "Rank correlation with strength, 95 % interval over clips": correlation_table(study),
        "Least strength distinguished from the original": sensitivity_table(study),
        "Blind to": verdict_table([study]),
        "Not computed": absence_list(study) or "All requested values are computed.",
    }
    sections = (
        f"{'#' if not number else '##'} {title}\n\n{part}\n"
        for number, (title, part) in enumerate(parts.items())
    )
    return "\n".join(sections)


def _table(study: Study, metrics: Sequence[str] | None, cell: Any, with_units: bool = False) -> str:
    ladders = study["ladders"]
    heads = [
        f"{name} ({ladder['unit']})" if with_units else name for name, ladder in ladders.items()
    ]
    lines = ["| metric | " + " | ".join(heads) + " |", "| --- |" + " ---: |" * len(heads)]
    for metric in metrics or answered_metrics([study]):
        answers = [study["answers"][ladder].get(metric) for ladder in ladders]
        cells = [BLANK if answer is None else cell(answer) for answer in answers]
        lines.append(f"| `{metric}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _correlation(answer: Answer) -> str:
    correlation, low, high = (answer[key] for key in ("correlation", "low", "high"))
    text = _number(round(correlation, 2))
    if low is None or high - low < 0.01:
        return text
    return f"{text} ({_number(round(low, 2))} to {_number(round(high, 2))})"


def _number(value: float | None) -> str:
    return BLANK if value is None else f"{value + 0.0:g}".replace("-", "\N{MINUS SIGN}")
