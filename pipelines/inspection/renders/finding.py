"""One thing that is wrong with the renders of a view."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

Fault = Literal[
    "blank frames",
    "repeated frames",
    "wrong size",
    "wrong camera",
    "mirrored",
    "frame offset",
    "channel order",
    "tone curve",
    "value range",
    "truth copied in",
    "shift",
    "wrong resize",
    "up-scaled",
    "JPEG",
]
Verdict = Literal["certain", "likely"]
NAMED = 3


@dataclass(frozen=True)
class DoctorFinding:
    """A fault of one view.

    Attributes:
        view: name of the view.
        fault: what kind of fault.
        verdict: ``certain`` where nothing else explains the evidence, ``likely`` where an unusual rendering could.
        measured: the evidence in words and numbers.
        values: the same for programs; names carry their units.
        advice: what to do about it.
    """

    view: str
    fault: Fault
    verdict: Verdict
    measured: str
    values: Mapping[str, float] = field(default_factory=dict)
    advice: str = ""


def verdict_of(is_certain: bool) -> Verdict:
    """The stronger or the weaker verdict."""
    return "certain" if is_certain else "likely"


def findings_table(findings: Sequence[DoctorFinding], width: int = 130) -> str:
    """The findings as text; views with word for word the same finding share a line."""
    if not findings:
        return "nothing found: no sign of any of the known faults"
    from ggvs_eval.pipelines.inspection.text_table import text_table

    groups: dict[tuple[str, str, str, str], list[str]] = {}
    for finding in findings:
        key = (finding.fault, finding.verdict, finding.measured, finding.advice)
        groups.setdefault(key, []).append(finding.view)
    rows = [(_named(views), *key) for key, views in groups.items()]
    return text_table(("view", "fault", "verdict", "measured", "what to do"), rows, width, stretched=("measured", "what to do"))


def _named(views: Sequence[str]) -> str:
    more = f" and {len(views) - NAMED} more" if len(views) > NAMED else ""
    return ", ".join(views[:NAMED]) + more
