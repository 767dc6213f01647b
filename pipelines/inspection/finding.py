"""One answer about a capture, all of them together, and both as text."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

Verdict = Literal["ok", "warn", "bad", "unknown"]
# From harmless to harmful: a rig is as good as its worst camera; what could not be found out is told, but stops nobody.
SEVERITY: Mapping[str, int] = {"ok": 0, "unknown": 1, "warn": 2, "bad": 3}
RIG = "rig"
NAMED = 8
# A rig's cameras fit; of a moving camera's hundreds of pictures the worst are shown.
MOST_LINES = 24
Line = tuple[str, str, str, str, str]
COLUMNS: dict[str, dict[str, object]] = {
    "question": {"no_wrap": True},
    "verdict": {"no_wrap": True},
    "camera": {"max_width": 24},
    "measured": {"ratio": 3},
    "what to do": {"ratio": 2},
}


@dataclass(frozen=True)
class Finding:
    """The answer to one question about one camera or the whole rig.

    Attributes:
        subject: name of a camera, or ``rig``.
        question: what was asked, e.g. ``time offset``.
        verdict: ``ok``, ``warn`` (look at it), ``bad`` (results would be spoilt) or ``unknown`` (could not be found out).
        measured: what was found, in words and numbers, or why nothing was.
        values: the same for programs; names carry their units.
        advice: what to do about it; empty where nothing is to be done.
    """

    subject: str
    question: str
    verdict: Verdict
    measured: str
    values: Mapping[str, Any] = field(default_factory=dict)
    advice: str = ""


@dataclass(frozen=True)
class CaptureCheck:
    """Everything that was found out about one capture.

    Attributes:
        path: the capture.
        findings: in the order of the questions; per question the rig first, then its cameras.
        seconds: how long the check took.
    """

    path: Path
    findings: tuple[Finding, ...]
    seconds: float = 0.0

    @property
    def is_usable(self) -> bool:
        """Whether nothing was found that would spoil results."""
        return all(finding.verdict != "bad" for finding in self.findings)

    def of(self, question: str) -> tuple[Finding, ...]:
        """The answers to one question."""
        return tuple(finding for finding in self.findings if finding.question == question)

    def to_json(self) -> dict[str, Any]:
        """The check as plain values for a JSON file."""
        findings = [{**asdict(finding), "values": dict(finding.values)} for finding in self.findings]
        return {
            "capture": str(self.path),
            "is_usable": self.is_usable,
            "seconds": round(self.seconds, 2),
            "findings": findings,
        }

    def table(self, width: int = 130) -> str:
        """The check as text: one line per question, and one for each group of cameras that deviate."""
        return check_table(self.findings, width)


def worst(findings: tuple[Finding, ...]) -> Verdict:
    """The most harmful of some verdicts; ``ok`` where there are none."""
    return max((finding.verdict for finding in findings), key=SEVERITY.__getitem__, default="ok")


def graded(value: float, warn_above: float, bad_above: float) -> Verdict:
    """Verdict on a number that should be small."""
    return "bad" if value > bad_above else "warn" if value > warn_above else "ok"


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
