"""The figures of a paper, each by its kind, as PNG and PDF."""

from pathlib import Path
from typing import Literal

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.figures.crop_figure import draw_crops, draw_failures
from ggvs_eval.reports.figures.k_figure import draw_k
from ggvs_eval.reports.figures.regions import Rule
from ggvs_eval.reports.figures.slices import write_slices
from ggvs_eval.reports.figures.stream_figure import draw_rates, rate_panels
from ggvs_eval.reports.model.measured import MeasuredRun, read_run

FigureKind = Literal["crops", "failures", "epi", "time", "k", "stream"]
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
        kind: ``crops`` of one frame, ``failures`` of a method, slices ``epi`` and ``time``, the curves over ``k``, or
            ``stream``: quality on the screen over pictures per second.
        out: file to write; without a suffix both a PNG and a PDF.
        rule: by which crops are chosen, see `ggvs_eval.reports.figures.regions.RULES`.
        method: label whose worst squares are shown; ours, or the first, where None.
        boxes: squares of crops, cases of failures.
        view: test view of crops and ``time``.
        frame: frame of crops.
        row: image row of slices.
        metrics: panels of ``k``.

    Raises:
        ResultsError: as of the single figures, or no boxes.
    """
    if boxes < 1:
        raise ResultsError(f"wanted at least one box, got {boxes}")
    files = (out,) if out.suffix else tuple(out.with_suffix(suffix) for suffix in BOTH)
    if kind == "k":
        return tuple(draw_k(folder, file, metrics) for file in files)
    if kind in ("epi", "time"):
        return tuple(write_slices(folder, kind, row, view, file) for file in files)
    run = read_run(folder)
    if kind == "stream":
        return tuple(draw_rates(rate_panels([run]), file) for file in files)
    label = method or first_choice(run)
    if kind == "failures":
        return draw_failures(run, files, label, boxes)
    return draw_crops(run, files, rule, label, boxes, view, frame)


def first_choice(run: MeasuredRun) -> str:
    """The method that a figure is about where nobody says: ours, or the first."""
    if not run.pictured:
        raise ResultsError(f"{run.folder.root}: no method has whole renders to show; run `ggvs-eval render` again")
    return next((label for label in run.pictured if label in run.ours), run.pictured[0])
