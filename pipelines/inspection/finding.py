"""One answer about a capture, and all of them together."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

Verdict = Literal["ok", "warn", "bad", "unknown"]
# From harmless to harmful: a rig is as good as its worst camera; what could not be found out is told, but stops nobody.
SEVERITY: Mapping[str, int] = {"ok": 0, "unknown": 1, "warn": 2, "bad": 3}
RIG = "rig"


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
        from ggvs_eval.pipelines.inspection.findings_table import check_table

        return check_table(self.findings, width)


def worst(findings: tuple[Finding, ...]) -> Verdict:
    """The most harmful of some verdicts; ``ok`` where there are none."""
    return max((finding.verdict for finding in findings), key=SEVERITY.__getitem__, default="ok")


def graded(value: float, warn_above: float, bad_above: float) -> Verdict:
    """Verdict on a number that should be small."""
    return "bad" if value > bad_above else "warn" if value > warn_above else "ok"
