"""The figures of a paper, each by its kind, as PNG and PDF."""

from pathlib import Path
from typing import Literal

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.figures.crop_figure import draw_crops, draw_failures
from ggvs_eval.reports.figures.k_figure import draw_k
from ggvs_eval.reports.figures.look import FULL_LOOK, FigureLook, only_methods, score_words
from ggvs_eval.reports.figures.regions import RULES, Rule, Square, find_regions, given_regions
from ggvs_eval.reports.figures.side_by_side import write_side_by_side
from ggvs_eval.reports.figures.slices import draw_slices, slices_of
from ggvs_eval.reports.figures.stream_figure import draw_rates, rate_panels
from ggvs_eval.reports.model.measured import read_run

FigureKind = Literal["crops", "failures", "epi", "time", "k", "stream", "video"]
BOTH = (".png", ".pdf")


def write_figure(
    folder: Path,
    kind: FigureKind,
    out: Path,
    *,
    rule: Rule = "different",
    method: str | None = None,
    boxes: int = 2,
    view: str | None = None,
    frame: int | None = None,
    row: int | None = None,
    metrics: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
    squares: tuple[Square, ...] = (),
    look: FigureLook | None = None,
    has_scores: bool = False,
) -> tuple[Path, ...]:
    """Write a figure.

    Args:
        folder: run folder, rendered and scored; of ``k`` the folder of a sweep.
        kind: ``crops`` of one frame, ``failures`` of a method, slices ``epi`` and ``time``, the curves over ``k``,
            ``stream``: quality on the screen over pictures per second, or a ``video`` of the methods beside each other.
        out: file to write; without a suffix both a PNG and a PDF.
        rule: by which crops are chosen, see `ggvs_eval.reports.figures.regions.RULES`.
        method: label whose worst squares are shown; ours without a variant, or the first, where None.
        metrics: panels of ``k``, scores of the others.
        methods: labels of those that are shown, in this order; all by default.
        squares: of crops, instead of those that the rule finds.
        look: width and title; each kind's own width where None.
        has_scores: whether each method's scores follow its name.

    Raises:
        ResultsError: as of the single figures, or no boxes.
    """
    if boxes < 1:
        raise ResultsError(f"wanted at least one box, got {boxes}")
    if kind == "video":
        return (
            write_side_by_side(only_methods(read_run(folder), methods), out if out.suffix else out.with_suffix(".mp4"), view),
        )
    files = (out,) if out.suffix else tuple(out.with_suffix(suffix) for suffix in BOTH)
    if kind == "k":
        return tuple(draw_k(folder, file, metrics, look) for file in files)
    look, run = look or FULL_LOOK, only_methods(read_run(folder), methods)
    scores = score_words(run, metrics) if has_scores else {}
    if kind in ("epi", "time"):
        slices = slices_of(run, kind, row, view)
        return tuple(draw_slices(slices, file, look, scores) for file in files)
    if kind == "stream":
        return tuple(draw_rates(rate_panels([run]), file) for file in files)
    if not run.pictured:
        why = "; ".join(f"{label} {reason}" for label, reason in run.results.set_aside.items())
        raise ResultsError(
            f"{run.folder.root}: no method has every frame, and only such are shown: {why}; render what is missing"
        )
    label = method or run.ours_first[0]
    if kind == "failures":
        return draw_failures(run, files, label, boxes, look)
    if squares:
        return draw_crops(run, files, given_regions(run, squares, view, frame), "chosen by eye", look, scores)
    regions = find_regions(run, rule, label, boxes, view=view, frame=frame)
    return draw_crops(run, files, regions, RULES[rule].format(name=run.name(label)), look, scores)
