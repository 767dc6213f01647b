"""Results of a checked table: text for the terminal, CSV, a badge, and a page that shows the table
as it was printed.
"""

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.contrib.explain.check import VERDICTS, CheckedCell, Verdict, expected_by_chance
from ggvs_eval.files.atomic import write_text
from ggvs_eval.files.templates import open_templates
from ggvs_eval.pipelines.inspection.table import text_table
from ggvs_eval.progress import counted
from ggvs_eval.reports.model.measured import MeasuredRun

TEMPLATES = Path(__file__).parent / "templates"
MATCHED: tuple[Verdict, ...] = ("reproduced", "other convention")
HEADS = (
    "method",
    "scene",
    "metric",
    "quoted",
    "verdict",
    "method_of_run",
    "measured",
    "reason",
    "by_chance",
    "neighbour",
)


def summary(checked: Sequence[CheckedCell]) -> str:
    """Return the counts of all verdicts in one sentence, and how many matches chance would give."""
    counts = Counter(cell.verdict for cell in checked)
    expected, tail = expected_by_chance(checked)
    named = ", ".join(f"{counts[name]} {name}" for name in VERDICTS if counts[name])
    tested = len(checked) - counts["not checked"]
    odds = "less than 1e-6" if tail < 1e-6 else f"{tail:.2g}"
    chances = (
        f"; chance alone would match {expected:.1f} (probability of as many: {odds})"
        if tested
        else ""
    )
    return f"{counted(len(checked), 'cell')}: {named}{chances}"


def check_text(checked: Sequence[CheckedCell]) -> str:
    """Return the summary, and one line per cell that is not simply reproduced or not distinguished
    from its neighbour.
    """
    notable = [row for row in checked if row.verdict != "reproduced" or row.neighbour]
    rows = []
    for row in notable:
        cell, why = row.quoted, "; ".join(filter(None, (row.reason, row.neighbour)))
        rows.append(
            (
                f"{cell.method} {cell.scene}".strip(),
                cell.metric,
                cell.text,
                _measured(row),
                row.verdict,
                why,
            )
        )
    heads = {"row": 1, "metric": 0, "quoted": 0, "measured": 0, "verdict": 0, "why": 2}
    return summary(checked) + (f"\n\n{text_table(heads, rows)}" if rows else "")


def check_csv(checked: Sequence[CheckedCell]) -> str:
    """Return one line per cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADS)
    for row in checked:
        cell = row.quoted
        result = (
            row.verdict,
            row.label,
            "" if row.measured is None else f"{row.measured:.8g}",
            row.reason,
        )
        writer.writerow(
            (
                cell.method,
                cell.scene,
                cell.metric,
                cell.text,
                *result,
                f"{row.by_chance:.3g}",
                row.neighbour,
            )
        )
    return text.getvalue()


def write_check(
    folder: Path, file: Path, checked: Sequence[CheckedCell], runs: Sequence[MeasuredRun]
) -> None:
    """Write ``index.html``, ``table_check.csv`` and ``badge.svg``; equal inputs give equal bytes.

    Args:
        file: the published table, named on the page.
    """
    templates = open_templates(TEMPLATES)
    counts = Counter(cell.verdict for cell in checked)
    tested = len(checked) - counts["not checked"]
    matched = sum(counts[name] for name in MATCHED)
    badge = {
        "matched": matched,
        "tested": tested,
        "is_whole": matched == tested,
        "is_bad": bool(counts["not reproduced"]),
    }
    places = {(cell.quoted.row, cell.quoted.heads): cell for cell in checked}
    columns = {
        cell.quoted.heads: " ".join(filter(None, (cell.quoted.scene, cell.quoted.metric)))
        for cell in checked
    }
    rows = {cell.quoted.row: cell.quoted.method for cell in checked}
    page = templates.get_template("table_check.html.j2").render(
        name=file.name,
        summary=summary(checked),
        verdicts=VERDICTS,
        counts=counts,
        columns=columns,
        rows=rows,
        places=places,
        checked=checked,
        measured=_measured,
        runs=[(run.title, run.protocol.name, run.protocol.sha256[:12]) for run in runs],
    )
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "table_check.csv", check_csv(checked))
    write_text(folder / "badge.svg", templates.get_template("badge.svg.j2").render(**badge))
    write_text(folder / "index.html", page)


def _measured(cell: CheckedCell) -> str:
    """The measured value with one digit more than the quoted one."""
    if cell.measured is None:
        return ""
    return f"{cell.measured:.{len(cell.quoted.text.partition('.')[2]) + 1}f}"
