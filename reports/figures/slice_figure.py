"""Slices as a labelled figure, methods below each other, as papers print them."""

from pathlib import Path

from ggvs_eval.reports.figures.figure_file import save_figure
from ggvs_eval.reports.figures.slices import Slices

WIDTH_IN = 7.0
CONTEXT_SHARE = 0.35
NO_TRUTH = "no truth on a virtual path"


def draw_slices(slices: Slices, out: Path) -> Path:
    """Draw slices below each other, with the frame that they cut on top."""
    from matplotlib.figure import Figure

    context_in = WIDTH_IN * CONTEXT_SHARE * slices.context.shape[0] / slices.context.shape[1]
    figure = Figure(figsize=(WIDTH_IN, 0.6 + context_in + 0.95 * len(slices.strips)), layout="constrained")
    axes = figure.subplots(1 + len(slices.strips), 1, height_ratios=[context_in, *[0.8] * len(slices.strips)])
    axes[0].imshow(slices.context)
    axes[0].axhline(slices.row, color="#ff3b30", linewidth=1.2)
    axes[0].set_title(f"Row {slices.row} in {slices.title}\n(row: {slices.chosen_by})", fontsize=8)
    axes[0].set_axis_off()
    for axis, strip in zip(axes[1:], slices.strips, strict=True):
        axis.set_title(strip.name, loc="left", fontsize=8, pad=2)
        if strip.image is None:
            axis.text(0.5, 0.5, NO_TRUTH, ha="center", va="center", fontsize=8, transform=axis.transAxes)
            axis.set(xticks=[], yticks=[])
            continue
        samples, width = strip.image.shape[:2]
        axis.imshow(strip.image, aspect="auto", interpolation="nearest", extent=(0, width, samples, 0))
        axis.set_ylabel("v (pose)" if slices.kind == "epi" else "t (frame)", fontsize=7)
        axis.tick_params(labelsize=6, labelbottom=axis is axes[-1])
    axes[-1].set_xlabel("x (pixel)", fontsize=7)
    return save_figure(figure, out)
