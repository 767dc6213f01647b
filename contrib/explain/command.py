"""The verbs of the command line that question published numbers: explain and check-table."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.built_in import CONVENTIONS
from ggvs_eval.errors import RenderError, ResultsError
from ggvs_eval.pipelines.commands.flags import NONE
from ggvs_eval.pipelines.commands.renders import RENDERS_DEFAULTS, Renders, RendersFlags

Quoted = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="VALUE")]
Metric = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar=f"{{{','.join(CONVENTIONS)}}}")]
Scored = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="RUN ...", help_behavior_hint="(required)"),
]
Rows = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=METHOD ...", help_behavior_hint=NONE)]


def explain(
    renders: Renders,
    metric: Metric,
    quoted: Quoted,
    method: str | None = None,
    mask: str | None = None,
    all: bool = False,
    source: RendersFlags = RENDERS_DEFAULTS,
) -> None:
    """Find the metric conventions that give a quoted number.

    `ggvs-eval check-table` checks a whole published table.

    Args:
        renders: frames in any form that `score` accepts, with --capture; or a run folder.
        metric: metric family.
        quoted: value as printed, with its digits.
        method: method of the run folder, if it has several.
        mask: for masked conventions: picture, white where pixels count; folder with VIEW.png or
            VIEW/FRAME.png; or a box in pixels as LEFT,TOP,RIGHT,BOTTOM.
        all: show every convention that was tried, not only the nearest.
        source: capture and protocol of the renders.
    """
    from ggvs_eval.contrib.explain.explain import explain as recompute
    from ggvs_eval.contrib.explain.explain import (
        explanation_table,
        followed,
        metric_family,
        printed,
        read_masks,
    )
    from ggvs_eval.pipelines.inspection.renders.identity import views_of_run
    from ggvs_eval.pipelines.run.decoding import fast_truth

    metric_family(metric)  # a mistyped name or number shows before anything is read
    printed(quoted)
    with source.open(renders) as (folder, labels):
        if method is None and len(labels) != 1:
            raise RenderError(
                f"{folder.root}: wanted one method, got {', '.join(labels)}; name one with --method"
            )
        views = views_of_run(folder, method or labels[0], as_measured=True)
        masks = read_masks(mask, views, folder.protocol().measurement) if mask else None
        with followed(views) as read:
            conventions = recompute(metric, quoted, read, masks, fast_truth(folder))
        print(explanation_table(metric, quoted, conventions, shows_all=all))


def check_table(
    runs: Scored, table: Path, rows: Rows = (), metric: str | None = None, out: Path | None = None
) -> None:
    """Check every cell of a published table against scored runs.

    Each cell is reproduced (to its printed digits), equal under another convention, undecided
    (within the interval of this clip) or not reproduced. Ends with 1 if a cell is not reproduced,
    or none was checked.

    Args:
        runs: scored run folders, one per scene.
        table: published table: .csv, .tex, .md, or 3DGS's .json; a row per method, a column per
            metric or scene.
        rows: names of rows that are neither labels nor titles of methods, e.g. "Full model=ours".
        metric: metric of all columns, if the columns are scenes.
        out: folder for a page, a CSV and a badge.
    """
    from ggvs_eval.contrib.explain.check import Runs, check_cells
    from ggvs_eval.contrib.explain.quoted_tables import read_quoted
    from ggvs_eval.contrib.explain.results_of_check import check_text, write_check
    from ggvs_eval.reports.model.measured import read_scores
    from ggvs_eval.reports.run_groups import runs_by_protocol

    named = dict(pair.rpartition("=")[::2] for pair in rows)
    if "" in named:
        raise ResultsError(
            f"--rows: wanted NAME=METHOD, got {' '.join(rows)}; write the name as in the table"
        )
    quoted = read_quoted(table, metric or "")
    scored_runs = [run for group in runs_by_protocol(runs, read_scores) for run in group]
    checked = check_cells(quoted.cells, Runs(scored_runs, named))
    for head, why in quoted.left_out.items():
        print(f"column {head}: {why}, not checked", file=sys.stderr)
    print(check_text(checked))
    if out is not None:
        write_check(out, table, checked, scored_runs)
        print(out / "index.html")
    if any(cell.verdict == "not reproduced" for cell in checked) or all(
        cell.verdict == "not checked" for cell in checked
    ):
        sys.exit(1)
