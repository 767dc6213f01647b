"""The verbs of the command line that show what was measured: report, table, figure, compare."""

from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ggvs_eval import built_in
from ggvs_eval.pipelines.commands.captures import Output, Run
from ggvs_eval.plugins import Registry

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
    """Write the page, tables (Markdown, CSV, LaTeX, Excel), figures and the comparison with the paper.

    Args:
        runs: run folders; those of one protocol share a section of the page.
        out: folder to write; RUN/report of the first run by default, the file leaderboard.html, or the folder tracked.
        to: page with all that belongs to it; leaderboard: the tables alone on one page, for which no frames are needed; or a
            tracker, whose package must be installed: its files are written without a network.
        standalone: make a page that loads nothing; otherwise it shows frames at full size from its run folder.
        columns: of the tables in Markdown, LaTeX and Excel, in this order: PSNR SSIM LPIPS TCC.
    """
    if to == "leaderboard":
        from ggvs_eval.reports.page.leaderboard import write_leaderboard

        print(write_leaderboard(runs, out or Path("leaderboard.html")))
    elif to == "page":
        from ggvs_eval.pipelines.run.evaluate import report as write

        print(write(runs, out, standalone=standalone, columns=columns))
    else:
        print(TRACKERS[to](runs, to, out or Path("tracked")))


def table(
    runs: Runs,
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(all by default)")] = (),
    to: Literal["markdown", "latex", "csv"] = "markdown",
    notes: bool = False,
) -> None:
    """Print a table of scored runs for a paper, in seconds; of several scenes a table per metric with a column for each.

    Args:
        runs: run folders of one protocol.
        columns: metrics, in this order: PSNR SSIM LPIPS TCC.
        to: the format.
        notes: also what the page says below its tables.
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
    """Draw a figure for a paper, labelled, every method beside the truth.

    Args:
        kind: crops: a frame with enlarged squares; failures: the worst squares of a method, one per view; epi: an image row along
            the camera path; time: an image row of a view along time; k: quality and time over the number of source views; stream:
            quality on the screen over pictures per second; video: the methods beside each other, for a supplement.
        run: run folder, rendered and scored; of k the folder of a sweep.
        out: PNG, PDF or SVG to write, MP4 of a video; a name without a suffix writes a PNG and a PDF.
        rule: squares of crops: where methods differ most, or where one method is worst.
        method: label of that one method; ours by default.
        boxes: number of squares.
        view: test view of crops, time and video; the one with the largest score, and the first, by default.
        frame: frame of crops; the one with the largest score by default.
        row: image row of epi and time; auto takes the one in which the methods differ most.
        metrics: panels of k, scores of the others.
        methods: labels of the methods that are shown, in this order.
        squares: of crops, in pixels, as the crop button of the page writes them.
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
    """Say what differs between two runs, method by method, or between two methods of a run, and whether that is significant.

    Args:
        first: run folder, or with --run the label of a method.
        second: the other one; differences are the first minus the second.
        run: run folder that both methods are in.
        views: also each view alone.
        csv: file for all differences, each view's too, unrounded.
    """
    from ggvs_eval.reports.tables.compare_runs import write_comparison

    print(write_comparison(first, second, run, views, csv))
