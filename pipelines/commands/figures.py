"""The verbs of the command line that show what was measured: report and table."""

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ggvs_eval import built_in
from ggvs_eval.plugins import Registry
from ggvs_eval.run_folder import RunFolder

LEADERBOARDS: Registry[Any] = Registry("pages", built_in.LEADERBOARDS)
TRACKERS: Registry[Any] = Registry("trackers", built_in.TRACKERS)
Runs = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="RUN [RUN ...]", help_behavior_hint="(at least one)"),
]
Destination = Literal["page", "leaderboard", "tensorboard", "mlflow", "wandb"]


def report(
    runs: Runs,
    out: Path | None = None,
    to: Destination = "page",
    standalone: bool = False,
    columns: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(all by default)")
    ] = (),
) -> None:
    """Write the page, tables, figures and the comparison with the paper.

    Tables are written as Markdown, CSV, LaTeX and Excel.

    Args:
        runs: run folders; those of one protocol share a section of the page.
        out: folder to write; RUN/report of the first run, leaderboard.html or tracked/ by default.
        to: page; leaderboard (tables only, without frames); or a tracker, whose package must be
            installed.
        standalone: page without links to frames of the run folder.
        columns: columns of the Markdown, LaTeX and Excel tables, in order: PSNR SSIM LPIPS TCC.
    """
    if to == "leaderboard":
        print(LEADERBOARDS[to](runs, out or Path("leaderboard.html")))
    elif to == "page":
        from ggvs_eval.pipelines.run.evaluate import report as write
        from ggvs_eval.pipelines.run.outlook import describe_outdated

        for run in runs:
            if outdated := describe_outdated([RunFolder(run)]):
                print(
                    f"{run}: {outdated}; shown as measured; run `ggvs-eval run` to update",
                    file=sys.stderr,
                )
        print(write(runs, out, standalone=standalone, columns=columns))
    else:
        print(TRACKERS[to](runs, to, out or Path("tracked")))


def table(
    runs: Runs,
    columns: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(all by default)")
    ] = (),
    to: Literal["markdown", "latex", "csv"] = "markdown",
    notes: bool = False,
) -> None:
    """Print a table of scored runs for a paper.

    Several scenes give one table per metric, with a column per scene.

    Args:
        runs: run folders of one protocol.
        columns: metrics, in order: PSNR SSIM LPIPS TCC.
        to: output format.
        notes: also print the notes below the page's tables.
    """
    from ggvs_eval.reports.tables_of_runs import tables_of_runs

    print(tables_of_runs(runs, columns, to, notes), end="")
