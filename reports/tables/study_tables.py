"""Tables of a metric study as Markdown: correlations, the least strength that is told, and what each metric is blind to."""

from collections.abc import Mapping, Sequence
from typing import Any

from ggvs_eval.reports.figures.study_figure import Study, metric_rows

BLANK = "–"
Answer = Mapping[str, Any]


def correlation_table(study: Study, metrics: Sequence[str] | None = None) -> str:
    """Rank correlation of each metric with each degradation, with its interval where that is wider than a hundredth."""
    return _table(study, metrics, _correlation)


def sensitivity_table(study: Study, metrics: Sequence[str] | None = None) -> str:
    """The least strength that each metric tells from the undegraded, with the unit beside the degradation."""
    return _table(study, metrics, lambda answer: _number(answer["least_strength"]), with_units=True)


def verdict_table(study: Study, metrics: Sequence[str] | None = None) -> str:
    """What each metric sees, is blind to, and rewards."""
    lines = ["| metric | worse with strength | blind to | better with strength |", "| --- | --- | --- | --- |"]
    for metric in metrics or metric_rows([study]):
        verdicts = {ladder: answers[metric]["verdict"] for ladder, answers in study["answers"].items() if metric in answers}
        cells = [
            ", ".join(ladder for ladder, verdict in verdicts.items() if verdict == wanted) or BLANK
            for wanted in ("sees", "blind", "rewards")
        ]
        lines.append(f"| `{metric}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def ladder_table(study: Study) -> str:
    """The degradations, their strengths and units."""
    lines = ["| degradation | strengths | unit | what it is |", "| --- | --- | --- | --- |"]
    for name, ladder in study["ladders"].items():
        strengths = ", ".join(f"{strength:g}" for strength in ladder["strengths"])
        lines.append(f"| {name} | {strengths} | {ladder['unit']} | {ladder['describe']} |")
    return "\n".join(lines)


def absence_list(study: Study) -> str:
    """Metrics that have no number on any degradation, each with its reason."""
    answered = set(metric_rows([study]))
    reasons: dict[str, str] = {}
    for of_ladder in study["not_computed"].values():
        reasons |= {metric: why for metric, why in of_ladder.items() if metric not in answered}
    return "\n".join(f"- `{metric}` not computed: {why}" for metric, why in reasons.items())


def study_text(study: Study) -> str:
    """All tables of a study."""
    parts = {
        f"Metric study of {', '.join(study['captures'])}": f"{study['takes']} clips.",
        "Degradations": ladder_table(study),
        "Rank correlation with strength, 95 % interval over clips": correlation_table(study),
        "Least strength told from the undegraded": sensitivity_table(study),
        "Blind to": verdict_table(study),
        "Not computed": absence_list(study) or "Everything that was asked for is computed.",
    }
    sections = (f"{'#' if not number else '##'} {title}\n\n{part}\n" for number, (title, part) in enumerate(parts.items()))
    return "\n".join(sections)


def _table(study: Study, metrics: Sequence[str] | None, cell: Any, with_units: bool = False) -> str:
    ladders = study["ladders"]
    heads = [f"{name} ({ladder['unit']})" if with_units else name for name, ladder in ladders.items()]
    lines = ["| metric | " + " | ".join(heads) + " |", "| --- |" + " ---: |" * len(heads)]
    for metric in metrics or metric_rows([study]):
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
