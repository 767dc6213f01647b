"""Findings and other rows as a table of plain text."""

import io
import textwrap
from collections.abc import Iterable, Mapping, Sequence

from ggvs_eval.finding import RIG, SEVERITY, Finding, worst

WIDTH = 130  # characters
# A rig's cameras fit; of a moving camera's hundreds of pictures the worst are shown.
MOST_LINES = 24
NAMED, NAMES_WIDTH = 8, 24
Line = tuple[str, str, str, str, str]


def text_table(
    columns: Mapping[str, int], rows: Iterable[Sequence[str]], width: int = WIDTH
) -> str:
    """Lay out rows under their headings.

    Args:
        columns: heading -> share of the space that is left; 0 for a column as wide as its text,
            which is never wrapped.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, expand=True)
    for heading, share in columns.items():
        table.add_column(heading, ratio=share or None, no_wrap=not share, overflow="fold")
    for row in rows:
        table.add_row(*row)
    text = io.StringIO()
    Console(file=text, width=width, color_system=None, highlight=False, markup=False).print(table)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()).strip("\n")


def findings_table(
    findings: Sequence[Finding],
    width: int = WIDTH,
    heads: tuple[str, str] = ("question", "camera"),
    most_lines: int = MOST_LINES,
) -> str:
    """Return one line per question with the worst verdict where the rig has an answer, and one for
    each group that deviates.

    Args:
        findings: of any subjects and questions; questions come in the order of their first finding.
        most_lines: groups that are shown of one question; of the others only their number.
    """
    columns = {heads[0]: 0, "verdict": 0, heads[1]: 0, "measured": 3, "what to do": 2}
    lines: list[Line] = []
    for question in dict.fromkeys(finding.question for finding in findings):
        lines += _question_lines(
            [finding for finding in findings if finding.question == question], most_lines
        )
    return text_table(columns, _merged(lines), width)


def _merged(lines: Sequence[Line]) -> list[Line]:
    """Questions in a row that have the same answer, in one line: a capture that does not open
    leaves all of them unknown.
    """
    merged: list[Line] = []
    for line in lines:
        if merged and line[0] and merged[-1][1:] == line[1:] and line[1] == "unknown":
            merged[-1] = (f"{merged[-1][0]}\n{line[0]}", *line[1:])
        else:
            merged.append(line)
    return merged


def _question_lines(findings: Sequence[Finding], most_lines: int) -> list[Line]:
    """Return the line of the rig, and those of groups that deviate.

    The first names the question.
    """
    rig = next((finding for finding in findings if finding.subject == RIG), None)
    lines: list[Line] = []
    if rig is not None:
        verdict = worst(findings)
        lines.append(
            (
                rig.question,
                verdict.upper() if verdict == "bad" else verdict,
                "",
                rig.measured,
                rig.advice,
            )
        )
    said, groups = "", _alike(_deviating(findings, rig))
    for group in groups[:most_lines]:
        first = group[0]
        question, advice = (
            "" if lines else first.question,
            '"' if said and first.advice == said else first.advice,
        )
        lines.append(
            (
                question,
                f"  {first.verdict}" if rig else first.verdict,
                _named(group),
                first.measured,
                advice,
            )
        )
        said = first.advice
    if len(groups) > most_lines:
        n_left = sum(map(len, groups[most_lines:]))
        lines.append(
            ("", "  ...", "", f"{n_left} more cameras deviate; all are in the JSON file", "")
        )
    return lines


def _deviating(findings: Sequence[Finding], rig: Finding | None) -> list[Finding]:
    """Return the findings that are not ok.

    A reason that all share is given once, in the line of the rig.
    """
    if rig is not None and rig.verdict == worst(findings) == "unknown":
        return []
    hidden = {rig.measured} if rig is not None and rig.verdict == "unknown" else set()
    return [
        finding
        for finding in findings
        if finding.subject != RIG and finding.verdict != "ok" and finding.measured not in hidden
    ]


def _alike(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Subjects with word for word the same answer together, the worst first."""
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in sorted(findings, key=lambda finding: -SEVERITY[finding.verdict]):
        groups.setdefault((finding.verdict, finding.measured, finding.advice), []).append(finding)
    return list(groups.values())


def _named(group: Sequence[Finding]) -> str:
    names = ", ".join(finding.subject for finding in group[:NAMED])
    return textwrap.fill(
        names + (f" and {len(group) - NAMED} more" if len(group) > NAMED else ""), NAMES_WIDTH
    )
