"""One answer about a camera of a capture or about the renders of a view."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

# Of a question that is put to every camera: ok, could not be found out, look at it, or results
# would be spoilt. Of a fault that is given only if there is one: an unusual rendering could explain
# the evidence too, or nothing else does.
Verdict = Literal["ok", "unknown", "warn", "bad", "likely", "certain"]
# From harmless to harmful: a rig is as good as its worst camera; what could not be found out is
# reported, but stops nothing.
SEVERITY: Mapping[str, int] = {
    "ok": 0,
    "unknown": 1,
    "warn": 2,
    "likely": 2,
    "bad": 3,
    "certain": 3,
}
RIG = "rig"


@dataclass(frozen=True)
class Finding:
    """The answer to one question about one camera or view, or about the whole rig.

    Attributes:
        subject: name of a camera or view, or ``rig``.
        question: what was asked, e.g. ``time offset``; of renders the fault, e.g. ``frame offset``.
        verdict: how bad it is, or how sure.
        measured: what was found, in words and numbers, or why nothing was.
        values: the same for programs; names carry their units.
        advice: what to do about it; empty if nothing is to be done.
    """

    subject: str
    question: str
    verdict: Verdict
    measured: str
    values: Mapping[str, Any] = field(default_factory=dict)
    advice: str = ""


def worst(findings: Iterable[Finding]) -> Verdict:
    """Return the most harmful of some verdicts; ``ok`` if there are none."""
    return max((finding.verdict for finding in findings), key=SEVERITY.__getitem__, default="ok")


def graded(value: float, warn_above: float, bad_above: float) -> Verdict:
    """Verdict on a number that should be small."""
    return "bad" if value > bad_above else "warn" if value > warn_above else "ok"


def verdict_of(is_certain: bool) -> Verdict:
    """Return the stronger or the weaker verdict on a fault."""
    return "certain" if is_certain else "likely"
