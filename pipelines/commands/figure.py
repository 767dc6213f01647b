"""The verb of the command line that draws figures for a paper."""

from typing import Annotated, Any, Literal

import tyro

from ggvs_eval.pipelines.commands.flags import Output, Run
from ggvs_eval.reports.figures.look import FigureLook, parse_row, parse_width
from ggvs_eval.reports.figures.paper_figures import write_figure
from ggvs_eval.reports.figures.regions import parse_square

Kind = Annotated[
    Literal["crops", "failures", "epi", "time", "k", "stream", "video"], tyro.conf.Positional
]


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
    metrics: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(default: PSNR LPIPS)"),
    ] = (),
    methods: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="METHOD ...", help_behavior_hint="(all by default)")
    ] = (),
    squares: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="LEFT,TOP,SIDE ...", help_behavior_hint="(by --rule)"),
    ] = (),
    width: str | None = None,
    title: bool = True,
    scores: bool = False,
) -> None:
    """Draw a labelled figure for a paper.

    Args:
        kind: crops: enlarged squares of a frame; failures: worst squares of a method; epi: an image
            row along the camera path; time: an image row over time; k: quality and time over K;
            stream: displayed quality over fps; video: methods side by side.
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
    options: dict[str, Any] = {
        "rule": rule,
        "method": method,
        "boxes": boxes,
        "view": view,
        "frame": frame,
        "metrics": metrics,
        "methods": methods,
    }
    options |= {
        "row": parse_row(row),
        "squares": tuple(map(parse_square, squares)),
        "has_scores": scores,
    }
    look = None if width is None and title else FigureLook(parse_width(width or "7in"), title)
    print(*write_figure(run, kind, out, look=look, **options), sep="\n")
