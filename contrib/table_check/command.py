"""The verb of the command line that checks a whole published table against scored runs: check-table."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.errors import ResultsError
from ggvs_eval.pipelines.commands.flags import NONE

Scored = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN ...", help_behavior_hint="(required)")]
Rows = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=METHOD ...", help_behavior_hint=NONE)]


def check_table(runs: Scored, table: Path, rows: Rows = (), metric: str | None = None, out: Path | None = None) -> None:
    """Check every cell of a published table against scored runs.

    Each cell is reproduced (to its printed digits), equal under another convention, undecided (within the interval of this clip)
    or not reproduced. Ends with 1 if a cell is not reproduced, or none was checked. `explain --table FILE RUN ...` is the same.

    Args:
        runs: scored run folders, one per scene.
        table: published table: .csv, .tex, .md; a row per method, a column per metric or scene.
        rows: names of rows that are neither labels nor titles of methods, e.g. "Full model=ours".
        metric: metric of all columns, if the columns are scenes.
        out: folder for a page, a CSV and a badge.
    """
    from ggvs_eval.contrib.table_check.check import Runs, check_cells
    from ggvs_eval.contrib.table_check.quoted_tables import read_quoted
    from ggvs_eval.contrib.table_check.results_of_check import check_text, write_check
    from ggvs_eval.reports.model.measured import read_scores
    from ggvs_eval.reports.run_groups import runs_by_protocol

    named = dict(pair.rpartition("=")[::2] for pair in rows)
    if "" in named:
        raise ResultsError(f"--rows: wanted NAME=METHOD, got {' '.join(rows)}; write the name as in the table")
    quoted = read_quoted(table, metric or "")
    measured = [run for group in runs_by_protocol(runs, read_scores) for run in group]
    checked = check_cells(quoted.cells, Runs(measured, named))
    for head, why in quoted.left_out.items():
        print(f"column {head}: {why}, not checked", file=sys.stderr)
    print(check_text(checked))
    if out is not None:
        write_check(out, table, checked, measured)
        print(out / "index.html")
    if any(one.verdict == "not reproduced" for one in checked) or all(one.verdict == "not checked" for one in checked):
        sys.exit(1)
