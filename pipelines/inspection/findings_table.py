"""The findings as text, for people."""

import io
from collections.abc import Sequence

from ggvs_eval.pipelines.inspection.finding import RIG, Finding, worst

NAMED = 8
# A rig's cameras fit; of a moving camera's hundreds of pictures the worst are shown.
MOST_LINES = 24
Line = tuple[str, str, str, str, str]


def check_table(findings: Sequence[Finding], width: int) -> str:
    """One line per question with its worst verdict, and below it the cameras that deviate.

    Args:
        findings: of any cameras and questions; questions come in the order of their first finding.
        width: of the text, characters.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, expand=True)
    for column, options in COLUMNS.items():
        table.add_column(column, **options)  # type: ignore[arg-type]
    for line in _merged([line for group in _by_question(findings) for line in _question_lines(group)]):
        table.add_row(*line)
    text = io.StringIO()
    Console(file=text, width=width, color_system=None, highlight=False, markup=False).print(table)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()).strip("\n")


COLUMNS: dict[str, dict[str, object]] = {
    "question": {"no_wrap": True},
    "verdict": {"no_wrap": True},
    "camera": {"max_width": 24},
    "measured": {"ratio": 3},
    "what to do": {"ratio": 2},
}


def _by_question(findings: Sequence[Finding]) -> list[list[Finding]]:
    questions = dict.fromkeys(finding.question for finding in findings)
    return [[finding for finding in findings if finding.question == question] for question in questions]


def _merged(lines: Sequence[Line]) -> list[Line]:
    """Questions in a row that have the same answer, in one line: a capture that does not open leaves all of them unknown."""
    merged: list[Line] = []
    for line in lines:
        if merged and line[0] and merged[-1][1:] == line[1:] and line[1] == "unknown":
            merged[-1] = (f"{merged[-1][0]}\n{line[0]}", *line[1:])
        else:
            merged.append(line)
    return merged


def _question_lines(findings: Sequence[Finding]) -> list[Line]:
    rig = next((finding for finding in findings if finding.subject == RIG), None)
    verdict = worst(tuple(findings))
    # One reason for all is said once, in the line of the rig.
    hidden = {rig.measured} if rig is not None and rig.verdict == "unknown" else set()
    deviating = [f for f in findings if f.subject != RIG and f.verdict != "ok" and f.measured not in hidden]
    if rig is not None and rig.verdict == verdict == "unknown":
        deviating = []
    lines = (
        [(findings[0].question, verdict.upper() if verdict == "bad" else verdict, "", rig.measured, rig.advice)] if rig else []
    )
    said, groups = "", _alike(deviating)
    for group in groups[:MOST_LINES]:
        names = [finding.subject for finding in group]
        shown = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
        first = group[0]
        question = "" if lines else first.question
        lines.append(
            (question, f"  {first.verdict}", shown, first.measured, '"' if said and first.advice == said else first.advice)
        )
        said = first.advice
    if len(groups) > MOST_LINES:
        left = sum(map(len, groups[MOST_LINES:]))
        lines.append(("", "  ...", "", f"{left} more cameras deviate; all are in the JSON file", ""))
    return lines


def _alike(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Cameras with word for word the same answer, together."""
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in sorted(findings, key=lambda finding: -["ok", "unknown", "warn", "bad"].index(finding.verdict)):
        groups.setdefault((finding.verdict, finding.measured, finding.advice), []).append(finding)
    return list(groups.values())
