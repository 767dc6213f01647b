"""Whether a method gets better or worse the longer it runs."""

from collections.abc import Sequence

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.model.measured import MeasuredRun, MetricNote
from ggvs_eval.reports.model.table import SHORT_MEANS, Cell, Column, Table, signed, spread_text
from ggvs_eval.results import split_label
from ggvs_eval.statistics.decomposition import read_panel
from ggvs_eval.statistics.drift import measure_drift
from ggvs_eval.statistics.intervals import LEVEL

LEAST_FRAMES = 100  # of a clip of which it is asked
PER_FRAMES = 100  # of which the table gives the slope
APART = "{}, apart from the scene"


def drift_table(run: MeasuredRun) -> Table | None:
    """Slopes over time of the first table's metrics, of methods that are not set aside.

    None of clips too short to ask.

    A scene that gets harder pulls all methods down, so next to each slope is that of the difference
    to the mean of all methods.
    """
    labels = [label for label in run.labels if label not in run.results.set_aside]
    if run.protocol.frames.count < LEAST_FRAMES:
        return None
    notes = [
        note
        for note in run.metrics.values()
        if note.group == next(iter(run.metrics.values())).group
    ]
    series = {
        note.name: series_of_labels
        for note in notes
        if (series_of_labels := _drift_series(run, note.name, labels))
    }
    if not series:
        return None
    notes_shown = [run.metrics[name] for name in series]
    heads = ("{}", APART) if len(labels) > 1 else ("{}",)  # one method alone is all of the mean
    columns = [
        Column(head.format(note.name), note.unit, note.higher_is_better)
        for note in notes_shown
        for head in heads
    ]
    means = {name: np.mean(list(by_label.values()), axis=0) for name, by_label in series.items()}
    rows = []
    for label in labels:
        cells = []
        for note in notes_shown:
            values = series[note.name].get(label)
            apart = None if values is None else values - means[note.name]
            cells += [_drift_cell(line, note) for line in (values, apart)[: len(heads)]]
        rows.append(run.row(label, cells))
    count = sum(cell.value is not None for row in rows for cell in row.cells)
    caption = (
        f"Change per {PER_FRAMES} frames of the line through the mean of the views, over "
        f"{run.protocol.frames.count} frames, with its {100 * LEVEL:.0f} % interval; apart from "
        "the scene: of the difference to the mean of all methods. Without any drift about "
        f"{max(1, round((1 - LEVEL) * count))} of these {count} intervals would exclude 0 by "
        f"chance. {SHORT_MEANS}"
    )
    return Table(
        key="drift",
        title="Drift over time",
        caption=caption,
        columns=tuple(columns),
        rows=tuple(rows),
        dataset=run.scene,
    )


def _drift_series(run: MeasuredRun, metric: str, labels: Sequence[str]) -> dict[str, Array]:
    """Return label -> value of each frame, the mean over the views, of the methods that have one in
    every view and frame.
    """
    series = {}
    for label in labels:
        try:
            panel = read_panel(run.results, metric, run.results.scenes[0], *split_label(label))
        except ResultsError:
            continue
        if len(panel.frames) == run.protocol.frames.count:
            series[label] = panel.values.mean(axis=0)
    return series


def _drift_cell(series: Array | None, note: MetricNote) -> Cell:
    if series is None:
        return Cell("not computed: no value of every frame")
    drift = measure_drift(series)
    slope, half = PER_FRAMES * drift.slope, PER_FRAMES * drift.half_width
    spread = spread_text(slope, half, note.decimals, bool(drift.short))
    return Cell(
        text=signed(slope, note.decimals),
        value=slope,
        best=False,
        shade=0.0,
        spread=spread,
        low=slope - half,
        high=slope + half,
        note=drift.short,
    )
