"""Axes, colours and dashes of all drawings, the same in the page and in the figures next to it.

How a figure is written.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.atomic import atomic_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Metadata keys that would carry a date or a version.
VOLATILE = {
    ".png": ("Software",),
    ".pdf": ("CreationDate", "Producer", "Creator"),
    ".svg": ("Date", "Creator"),
}
DOTS_PER_INCH = 200
# Okabe and Ito's colours, which colour-blind readers can distinguish; the page repeats them as CSS
# variables.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#b8a800", "#777777")
DASHES = ("", "7 3", "2 3", "9 3 2 3")
SIZE = (340, 170)
MARGIN = (46, 10, 10, 24)  # left, right, top, bottom


def save_figure(figure: "Figure", out: Path) -> Path:
    """Write a figure; the suffix of the file chooses the format."""
    if out.suffix not in VOLATILE:
        raise ResultsError(
            f"{out}: a figure's name must end in {', '.join(VOLATILE)}, got "
            f"{out.suffix or 'no suffix'}"
        )
    import matplotlib

    with (
        atomic_file(out) as temporary,
        matplotlib.rc_context({"svg.hashsalt": "ggvs-eval", "savefig.dpi": DOTS_PER_INCH}),
    ):
        figure.savefig(
            temporary, format=out.suffix[1:], metadata=dict.fromkeys(VOLATILE[out.suffix])
        )
    return out


@dataclass(frozen=True)
class Curve:
    """One method, by the name that is shown."""

    name: str
    frames: tuple[int, ...]
    values: tuple[float, ...]

    @property
    def pairs(self) -> tuple[tuple[int, float], ...]:
        """Each place along the axis with its value."""
        return tuple(zip(self.frames, self.values, strict=True))


@dataclass(frozen=True)
class Panel:
    """One metric in one view along time.

    Attributes:
        unit: unit of the values; empty if there is none.
        better: ``higher is better`` or ``lower is better``.
        bounds: first and last frame, lower and upper end of the values; the same in all views.
    """

    metric: str
    unit: str
    better: str
    view: str
    curves: tuple[Curve, ...]
    bounds: tuple[float, float, float, float]

    def x(self, frame: float) -> float:
        """Return the horizontal place of a frame in the drawing, in its pixels."""
        first, last = self.bounds[:2]
        return round(
            MARGIN[0] + (frame - first) / (last - first) * (SIZE[0] - MARGIN[0] - MARGIN[1]), 1
        )

    def y(self, value: float) -> float:
        """Return the vertical place of a value in the drawing, in its pixels."""
        low, high = self.bounds[2:]
        return round(
            MARGIN[2] + (high - value) / (high - low) * (SIZE[1] - MARGIN[2] - MARGIN[3]), 1
        )

    def points(self, curve: Curve) -> str:
        """Return a curve as the points of an SVG polyline."""
        return " ".join(
            f"{self.x(frame)},{self.y(value)}"
            for frame, value in zip(curve.frames, curve.values, strict=True)
        )

    def value_ticks(self) -> list[tuple[float, str]]:
        """Return the places and texts of the vertical axis, two to seven round numbers."""
        return [(self.y(value), text) for value, text in round_ticks(*self.bounds[2:])]

    def frame_ticks(self) -> list[tuple[float, str]]:
        """Return the places and texts of the horizontal axis: first, middle and last frame."""
        first, last = (int(bound) for bound in self.bounds[:2])
        return [
            (self.x(frame), str(frame))
            for frame in dict.fromkeys((first, (first + last) // 2, last))
        ]

    def logarithmic_ticks(self) -> list[tuple[float, str]]:
        """Return the same of an axis of decimal logarithms: 1, 2, 5, 10, ... within it."""
        low, high = self.bounds[:2]
        numbers = (
            digit * 10.0**power
            for power in range(math.floor(low), math.ceil(high) + 1)
            for digit in (1, 2, 5)
        )
        return [
            (self.x(math.log10(number)), f"{number:g}")
            for number in numbers
            if low <= math.log10(number) <= high
        ]


def method_numbers(names: Iterable[str]) -> dict[str, int]:
    """Number of each method by the name that is shown.

    It chooses the colour on every tab of a page and in its figures.
    """
    return {name: number for number, name in enumerate(dict.fromkeys(names))}


def round_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Return two to seven round numbers from `low` to `high`, each with its text.

    Examples:
        >>> round_ticks(0, 400)
        [(0.0, '0'), (100.0, '100'), (200.0, '200'), (300.0, '300'), (400.0, '400')]
    """
    step = 10.0 ** math.floor(math.log10((high - low) / 6))
    step *= next(factor for factor in (1, 2, 5, 10) if (high - low) / (step * factor) <= 6)
    decimals = max(0, -math.floor(math.log10(step)))
    return [
        (index * step, f"{index * step:.{decimals}f}")
        for index in range(math.ceil(low / step), math.floor(high / step) + 1)
    ]


def with_margin(low: float, high: float) -> tuple[float, float]:
    """Ends of an axis on which values from `low` to `high` do not touch the rim."""
    margin = 0.06 * (high - low) or max(abs(high), 1.0) * 0.01
    return low - margin, high + margin
