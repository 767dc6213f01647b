"""What a training writes down while it runs: one CSV line per step, one per validation."""

import csv
from collections.abc import Mapping
from pathlib import Path


class TrainingLog:
    """Two growing CSV files; lines of steps that will be done again are cut off first.

    Args:
        folder: of the training.
        step: steps done so far.
    """

    def __init__(self, folder: Path, step: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._steps, self._validations = folder / "log.csv", folder / "validation.csv"
        _cut(self._steps, step - 1)
        _cut(self._validations, step)

    def step(self, step: int, figures: Mapping[str, float]) -> None:
        """Write the figures of one step, numbered from 0."""
        _append(self._steps, step, figures)

    def validation(self, steps: int, figures: Mapping[str, float]) -> None:
        """Write what a network scores after so many steps."""
        _append(self._validations, steps, figures)


def _append(path: Path, step: int, figures: Mapping[str, float]) -> None:
    new = not path.is_file()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(["step", *figures])
        writer.writerow([step, *(f"{value:.6g}" for value in figures.values())])


def _cut(path: Path, last: int) -> None:
    """Drop lines of later steps than `last`, and a last line that a kill left unfinished."""
    if not path.is_file():
        return
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    whole = [line for line in lines if line.count(",") == header.count(",") and int(line.split(",")[0]) <= last]
    path.write_text("\n".join([header, *whole]) + "\n", encoding="utf-8")
