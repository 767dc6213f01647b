"""The log of a training: one CSV line per step, one per validation, and both drawn as curves."""

import csv
from collections.abc import Mapping
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


class TrainingLog:
    """Two growing CSV files; lines of steps that will be done again are cut off first."""

    def __init__(self, folder: Path, step: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._steps, self._validations = folder / "log.csv", folder / "validation.csv"
        _cut(self._steps, step - 1)
        _cut(self._validations, step)

    def step(self, step: int, figures: Mapping[str, float]) -> None:
        """Write the figures of one step, numbered from 0."""
        _append(self._steps, step, figures)

    def validation(self, steps: int, figures: Mapping[str, float]) -> None:
        """Write the validation scores of a step."""
        _append(self._validations, steps, figures)


def _append(path: Path, step: int, figures: Mapping[str, float]) -> None:
    """Add a line; a training that an earlier release began keeps the columns that it began with."""
    with path.open("a+", newline="", encoding="utf-8") as file:
        file.seek(0)
        columns = next(csv.reader(file), None)
        writer = csv.DictWriter(file, columns or ["step", *figures], extrasaction="ignore")
        if not columns:
            writer.writeheader()
        writer.writerow({"step": step} | {name: f"{value:.6g}" for name, value in figures.items()})


def _cut(path: Path, last: int) -> None:
    """Drop lines of later steps than `last`, and a last line that a kill left unfinished."""
    if not path.is_file():
        return
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    steps = [
        line
        for line in lines
        if line.count(",") == header.count(",") and int(line.split(",")[0]) <= last
    ]
    path.write_text("\n".join([header, *steps]) + "\n", encoding="utf-8")


def draw_curves(folder: Path, name: str) -> Path:
    """Write ``<name>.png`` from ``log.csv`` and ``validation.csv`` of a training."""
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
    axes.plot(
        log["step"],
        loss.rolling(SMOOTHED, min_periods=1, center=True).median(),
        color=LINE,
        label=f"median of {SMOOTHED}",
    )
    axes.set_yscale("log")


def _draw_validation(axes: "Axes", validation: pd.DataFrame) -> None:
    """The first figure of the validation, and that of its reference where it has one."""
    evaluated = validation.columns[1]
    axes.plot(
        validation["step"], validation[evaluated], "o-", color=LINE, markersize=3, label=evaluated
    )
    for reference in (f"{prefix}{evaluated}" for prefix in REFERENCES):
        if reference in validation:
            axes.plot(
                validation["step"], validation[reference], "--", color=REFERENCE, label=reference
            )
