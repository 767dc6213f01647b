"""A training drawn from its two logs: what it minimised, and what it scored on data that it never saw."""

from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from ggvs_eval.files.atomic import atomic_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SMOOTHED = 50  # steps of the running median: one batch says little
PANEL_IN = (3.4, 2.4)
DOTS_PER_INCH = 150
RAW, LINE, REFERENCE = "#c9d6e4", "#1f4e79", "#b45f06"
REFERENCES = ("geometric_", "start_")  # before a figure's name: of what the network has to beat


def draw_curves(folder: Path, name: str) -> Path:
    """Write ``<name>.png`` from ``log.csv`` and ``validation.csv`` of a training.

    Args:
        folder: of the training.
        name: of the task.

    Returns:
        The picture.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2 * PANEL_IN[0], PANEL_IN[1]), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_loss(left, pd.read_csv(folder / "log.csv"))
    _draw_validation(right, pd.read_csv(folder / "validation.csv"))
    for axes in (left, right):
        axes.set_xlabel("steps", fontsize=8)
        axes.tick_params(which="both", labelsize=7)
        axes.legend(fontsize=7, frameon=False)
    picture = folder / f"{name}.png"
    with atomic_file(picture) as temporary:
        figure.savefig(temporary, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return picture


def _draw_loss(axes: "Axes", log: pd.DataFrame) -> None:
    """Each step's loss, and the running median."""
    loss = log["loss"].where(log["loss"] > 0)
    axes.plot(log["step"], loss, color=RAW, linewidth=0.5, label="loss of a batch")
    axes.plot(log["step"], loss.rolling(SMOOTHED, min_periods=1, center=True).median(), color=LINE, label=f"median of {SMOOTHED}")
    axes.set_yscale("log")


def _draw_validation(axes: "Axes", validation: pd.DataFrame) -> None:
    """The first figure of the validation, and that of its reference where it has one."""
    evaluated = validation.columns[1]
    axes.plot(validation["step"], validation[evaluated], "o-", color=LINE, markersize=3, label=evaluated)
    for reference in (f"{prefix}{evaluated}" for prefix in REFERENCES):
        if reference in validation:
            axes.plot(validation["step"], validation[reference], "--", color=REFERENCE, label=reference)
