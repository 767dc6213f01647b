"""Table of the worst frames: how bad the worst one of each method is, how bad the worst twentieth,
and where both are.
"""

import math

from ggvs_eval.reports.model.measured import MeasuredRun, MetricNote
from ggvs_eval.reports.model.table import Cell, Column, Table, format_value, rank
from ggvs_eval.reports.tables.verdict import HEADLINES

TAIL = 5  # per cent of the frames that are at most so good
CAPTION = (
    f"Of all frames of all views: the value at the worst {TAIL} %, and the worst, each with its "
    "view and frame. Unlike means, these show single failures. Frames without a finite value are "
    "omitted."
)
Value = tuple[float, str, int]  # of a frame of a view


def worst_frames_table(run: MeasuredRun) -> Table | None:
    """Return two columns for each metric of the paper's tables that has values per frame.

    None if there is none.
    """
    by_metric = {
        metric: values
        for metric in HEADLINES
        if metric in run.metrics and (values := _values(run, metric))
    }
    if not by_metric or len(run.frames) * len(run.protocol.views.test) < 2:
        return None
    columns = tuple(column for metric in by_metric for column in _columns(run.metrics[metric]))
    rows = []
    for label in run.labels:
        cells = [
            cell
            for metric, values in by_metric.items()
            for cell in _cells(values.get(label, []), run.metrics[metric])
        ]
        rows.append(run.row(label, cells))
    return Table(
        key="worst",
        title="Worst frames",
        caption=CAPTION,
        columns=columns,
        rows=rank(columns, rows),
        dataset=run.scene,
    )


def _values(run: MeasuredRun, metric: str) -> dict[str, list[Value]]:
    """Return label -> its finite values per frame, of all views, the worst first."""
    values: dict[str, list[Value]] = {}
    for view in run.protocol.views.test:
        for label, series in run.per_frame(metric, view).items():
            frames, numbers = series.index.astype(int), map(float, series)
            finite = [
                (value, view, frame)
                for frame, value in zip(frames, numbers, strict=True)
                if math.isfinite(value)
            ]
            values.setdefault(label, []).extend(finite)
    sign = 1.0 if run.metrics[metric].higher_is_better else -1.0
    return {
        label: sorted(series, key=lambda value: sign * value[0])
        for label, series in values.items()
        if series
    }


def _columns(note: MetricNote) -> tuple[Column, Column]:
    percentile = TAIL if note.higher_is_better else 100 - TAIL
    text = f"{note.describe.rstrip('.')}, of {{}}."
    return (
        Column(
            name=f"{note.name}, {percentile}th percentile",
            unit=note.unit,
            higher_is_better=note.higher_is_better,
            describe=text.format("the worst twentieth"),
        ),
        Column(
            name=f"{note.name}, worst frame",
            unit=note.unit,
            higher_is_better=note.higher_is_better,
            describe=text.format("the worst frame"),
        ),
    )


def _cells(worst_first: list[Value], note: MetricNote) -> tuple[Cell, Cell]:
    """Return the value of the frame at the percentile, no mean of two, and that of the
    worst frame.
    """
    if not worst_first:
        return Cell("no value per frame"), Cell("no value per frame")
    at = max(0, math.ceil(len(worst_first) * TAIL / 100) - 1)
    return _cell(worst_first[at], note), _cell(worst_first[0], note)


def _cell(value: Value, note: MetricNote) -> Cell:
    number, view, frame = value
    return Cell(
        format_value(number, note.decimals),
        number,
        beside=f"({view}, {frame})",
        place=(view, frame),
    )
