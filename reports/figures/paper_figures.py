"""The figures of a paper, each by its kind, as PNG and PDF."""

from pathlib import Path
from typing import Literal

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.figures.crop_figure import draw_crops, draw_failures
from ggvs_eval.reports.figures.k_figure import draw_k
from ggvs_eval.reports.figures.regions import Rule
from ggvs_eval.reports.figures.slices import write_slices
from ggvs_eval.reports.model.measured import MeasuredRun, read_run

FigureKind = Literal["crops", "failures", "epi", "time", "k"]
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
) -> tuple[Path, ...]:
    """Write a figure.

    Args:
        folder: run folder, rendered and scored; of ``k`` the folder of a sweep.
        kind: ``crops`` of one frame, ``failures`` of a method, slices ``epi`` and ``time``, or the curves over ``k``.
        out: file to write; without a suffix both a PNG and a PDF.
    """
    if boxes < 1:
        raise ResultsError(f"wanted at least one box, got {boxes}")
    files = (out,) if out.suffix else tuple(out.with_suffix(suffix) for suffix in BOTH)
    if kind == "k":
        return tuple(draw_k(folder, file, metrics) for file in files)
    if kind in ("epi", "time"):
        return tuple(write_slices(folder, kind, row, view, file) for file in files)
    run = read_run(folder)
    label = method or first_choice(run)
    if kind == "failures":
        return draw_failures(run, files, label, boxes)
    return draw_crops(run, files, rule, label, boxes, view, frame)


def first_choice(run: MeasuredRun) -> str:
    """The method that a figure is about by default: ours, or the first."""
    if not run.pictured:
        raise ResultsError(f"{run.folder.root}: no method has whole renders to show; run `ggvs-eval render` again")
    return next((label for label in run.pictured if label in run.ours), run.pictured[0])
