"""The verbs of the command line that show what was measured: report, table, figure, compare."""

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ggvs_eval import built_in
from ggvs_eval.pipelines.commands.flags import Output, Run
from ggvs_eval.plugins import Registry
from ggvs_eval.run_folder import RunFolder

TRACKERS: Registry[Any] = Registry("trackers", built_in.TRACKERS)
Runs = Annotated[
    tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]", help_behavior_hint="(at least one)")
]
Destination = Literal["page", "leaderboard", "tensorboard", "mlflow", "wandb"]
Kind = Annotated[Literal["crops", "failures", "epi", "time", "k", "stream", "video"], tyro.conf.Positional]


def report(
    runs: Runs,
    out: Path | None = None,
    to: Destination = "page",
    standalone: bool = False,
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(all by default)")] = (),
) -> None:
    """Write the page, tables, figures and the comparison with the paper.

    Tables are written as Markdown, CSV, LaTeX and Excel.

    Args:
        runs: run folders; those of one protocol share a section of the page.
        out: folder to write; RUN/report of the first run, leaderboard.html or tracked/ by default.
        to: page; leaderboard (tables only, without frames); or a tracker, whose package must be installed.
        standalone: page without links to frames of the run folder.
        columns: columns of the Markdown, LaTeX and Excel tables, in order: PSNR SSIM LPIPS TCC.
    """
    if to == "leaderboard":
        from ggvs_eval.reports.page.leaderboard import write_leaderboard

        print(write_leaderboard(runs, out or Path("leaderboard.html")))
    elif to == "page":
        from ggvs_eval.pipelines.run.evaluate import report as write
        from ggvs_eval.pipelines.run.work_left import describe_outdated

        for run in runs:
            if outdated := describe_outdated([RunFolder(run)]):
                print(f"{run}: {outdated}; shown as measured; run `ggvs-eval run` to update", file=sys.stderr)
        print(write(runs, out, standalone=standalone, columns=columns))
    else:
        print(TRACKERS[to](runs, to, out or Path("tracked")))


def table(
    runs: Runs,
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(all by default)")] = (),
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


def figure(
    kind: Kind,
    run: Run,
    out: Output,
    rule: Literal["different", "worst"] = "different",
    method: str | None = None,
    boxes: int = 2,
    view: str | None = None,
    frame: int | None = None,
    row: Annotated[str, tyro.conf.arg(metavar="auto|N")] = "auto",
    metrics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(default: PSNR LPIPS)")] = (),
    methods: Annotated[tuple[str, ...], tyro.conf.arg(metavar="METHOD ...", help_behavior_hint="(all by default)")] = (),
    squares: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LEFT,TOP,SIDE ...", help_behavior_hint="(by --rule)")] = (),
    width: str | None = None,
    title: bool = True,
    scores: bool = False,
) -> None:
    """Draw a labelled figure for a paper.

    Args:
        kind: crops: enlarged squares of a frame; failures: worst squares of a method; epi: an image row along the camera path;
            time: an image row over time; k: quality and time over K; stream: displayed quality over fps; video: methods side by
            side.
        run: run folder, rendered and scored; the folder of a sweep for k.
        out: PNG, PDF or SVG to write, MP4 for video; a name without suffix writes PNG and PDF.
        rule: squares of crops: where methods differ most, or where --method is worst.
        method: method of --rule worst; ours by default.
        boxes: number of squares.
        view: test view of crops, time and video; the highest-scoring one, or the first, by default.
        frame: frame of crops; the highest-scoring one by default.
        row: image row of epi and time; auto: the row where methods differ most.
        metrics: panels of k, scores of the other figures.
        methods: methods to show, in order.
        squares: squares of crops, pixels, as the page's crop button writes them.
        width: figure width with unit (in, cm, mm, pt); default 7in, for k by its panels.
        title: draw a title.
        scores: append each method's scores to its label.
    """
    from ggvs_eval.reports.figures.look import FigureLook, parse_row, parse_width
    from ggvs_eval.reports.figures.paper_figures import write_figure
    from ggvs_eval.reports.figures.regions import parse_square

    options: dict[str, Any] = {
        "rule": rule,
        "method": method,
        "boxes": boxes,
        "view": view,
        "frame": frame,
        "metrics": metrics,
        "methods": methods,
    }
    options |= {"row": parse_row(row), "squares": tuple(map(parse_square, squares)), "has_scores": scores}
    look = None if width is None and title else FigureLook(parse_width(width or "7in"), title)
    print(*write_figure(run, kind, out, look=look, **options), sep="\n")


def compare(
    first: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="A")],
    second: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="B")],
    run: Path | None = None,
    views: bool = False,
    csv: Path | None = None,
) -> None:
    """Compare two runs, or two methods of a run, with paired tests.

    Args:
        first: run folder, or a method with --run.
        second: second run or method; differences are first minus second.
        run: run folder of both methods.
        views: also compare each view alone.
        csv: CSV file for all differences, unrounded, per view too.
    """
    from ggvs_eval.reports.tables.compare_runs import write_comparison

    print(write_comparison(first, second, run, views, csv))
