"""Quality over the time of a frame: one dot per method, time on a logarithmic axis."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ggvs_eval.reports.figures.axes import MARGIN, SIZE, Panel, with_margin
from ggvs_eval.reports.model.table import Column, Table
from ggvs_eval.reports.section import Report, SectionContent
from ggvs_eval.reports.tables.timing import TOTAL, timing_table

LINE_PX = 11  # between two names
NAME_PX = 5.6  # of a sign of a name, in wide fonts
Box = tuple[float, float, float, float]  # left, top, right, bottom
GAP_PX, DOT_PX = 7, 4  # from the middle of a dot to its name and to its rim


@dataclass(frozen=True)
class Dot:
    """One method.

    Attributes:
        x: place across, in pixels of the drawing.
        y: place down.
        name_x: where its name begins or, left of the dot, ends.
        name_y: line of its name, which keeps clear of other names.
        is_left: the name is left of the dot.
        words: name, time and value in words.
    """

    name: str
    x: float
    y: float
    name_x: float
    name_y: float
    is_left: bool
    words: str


@dataclass(frozen=True)
class QualityOverTime:
    """A metric over milliseconds per frame.

    Attributes:
        axes: metric and its ticks; its places across are decimal logarithms of milliseconds.
        untimed: names of methods that have a value and no time.
    """

    axes: Panel
    dots: tuple[Dot, ...]
    untimed: tuple[str, ...]


def quality_over_time(
    column: Column, values: Sequence[tuple[str, float]], timings: Sequence[Table]
) -> QualityOverTime | None:
    """Place each method that has a value and a time; None where fewer than two have.

    Args:
        column: the metric.
        values: name of a method, and its value.
        timings: tables of the time per frame, one per run; a method's time is the mean over those
            that have it.
    """
    times_ms = {name: _mean_time(name, timings) for name, _ in values}
    placed = [
        (name, value, time)
        for name, value in values
        if (time := times_ms[name]) and math.isfinite(value)
    ]
    if len(placed) < 2:
        return None
    logarithms = [math.log10(time) for _, _, time in placed]
    heights = [value for _, value, _ in placed]
    bounds = (
        min(logarithms) - 0.12,
        max(logarithms) + 0.12,
        *with_margin(min(heights), max(heights)),
    )
    better = "higher is better" if column.higher_is_better else "lower is better"
    axes = Panel(
        metric=column.name, unit=column.unit, better=better, view="", curves=(), bounds=bounds
    )
    dots: list[Dot] = []
    ordered = sorted(
        ((axes.x(math.log10(time)), axes.y(value), name) for name, value, time in placed),
        key=lambda dot: dot[1],
    )
    boxes: list[Box] = [(x - DOT_PX, y - DOT_PX, x + DOT_PX, y + DOT_PX) for x, y, _ in ordered]
    words = {
        name: f"{value:.4g}{f' {column.unit}' if column.unit else ''} in {time:.4g} ms"
        for name, value, time in placed
    }
    for x, y, name in ordered:
        left, _, right, bottom = _free_box(x, y, name, boxes)
        boxes.append((left, bottom - LINE_PX, right, bottom))
        dots.append(
            Dot(
                name=name,
                x=x,
                y=y,
                name_x=right if left < x else left,
                name_y=round(bottom - 2, 1),
                is_left=left < x,
                words=f"{name}: {words[name]}",
            )
        )
    return QualityOverTime(
        axes, tuple(dots), tuple(name for name, _ in values if not times_ms[name])
    )


def _free_box(x: float, y: float, name: str, boxes: Sequence[Box]) -> Box:
    """Return the place of a name that is nearest to its dot and clear of the other boxes, or the
    nearest one if none is clear.
    """
    width = NAME_PX * len(name)
    last = SIZE[0] - MARGIN[1] - width  # where a name ends that is too long for either side
    lines = (
        y + 3.5 + side * step * LINE_PX / 2
        for step in range(2 * SIZE[1] // LINE_PX)
        for side in (1, -1)
    )
    inside = [line for line in lines if MARGIN[2] <= line <= SIZE[1] - MARGIN[3]]
    ends = [left for left in (x + GAP_PX, x - GAP_PX - width) if MARGIN[0] <= left <= last] or [
        last
    ]
    places = [
        (left, line + 2 - LINE_PX, left + width, line + 2) for line in inside for left in ends
    ]
    meet = [
        any(
            spot[0] < box[2] and box[0] < spot[2] and spot[1] < box[3] and box[1] < spot[3]
            for box in boxes
        )
        for spot in places
    ]
    return next(
        (spot for spot, is_taken in zip(places, meet, strict=True) if not is_taken), places[0]
    )


def _mean_time(name: str, timings: Sequence[Table]) -> float | None:
    """Return the milliseconds of a frame of a method, the mean over runs.

    None if none was recorded.
    """
    times = [
        cell.value
        for table in timings
        for row in table.rows
        for column, cell in zip(table.columns, row.cells, strict=True)
        if row.name == name and column.name == TOTAL and cell.value
    ]
    return sum(times) / len(times) if times else None


def over_time_section(report: Report) -> SectionContent:
    """Return the headline metric of each group over the time of a frame, and the frames per second
    of each method.
    """
    values = {}
    for group in report.groups:
        verdict = group.verdict
        if verdict.column:
            methods = (*verdict.contenders, *verdict.parts)
            numbers = [
                (method.name, method.cell.value)
                for method in methods
                if method.cell.value is not None
            ]
            timings = list(map(timing_table, group.runs.values()))
            times_ms = {name: time for name, _ in numbers if (time := _mean_time(name, timings))}
            rates = {
                name: f"{1000 / time:.{1 if time > 100 else 0}f}" for name, time in times_ms.items()
            }
            values[group.id] = {
                "over_time": quality_over_time(verdict.column, numbers, timings),
                "rates": rates,
            }
    return SectionContent(values=values)
