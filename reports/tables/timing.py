"""Tables of time: per stage and frame, what reaches the screen, and whether a method gets better or worse the longer it runs.

Of the screen: rate and latency of each method, frames shown, repeated and dropped.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.images import read_image
from ggvs_eval.protocol import Stream
from ggvs_eval.reports.model.measured import MeasuredRun, MetricNote
from ggvs_eval.reports.model.table import SHORT_MEANS, Cell, Column, Table, format_value, rank, signed, spread_text
from ggvs_eval.results import split_label
from ggvs_eval.run_folder import JOB_FILE, frame_path, read_json
from ggvs_eval.statistics.decomposition import read_panel
from ggvs_eval.statistics.drift import measure_drift
from ggvs_eval.statistics.intervals import LEVEL

TOTAL = "total"
SCREEN_COLUMNS = (
    Column("time of a picture", "ms", False, "Sum of the median times of its stages, depth included where its time counts."),
    Column("rate", "pictures/s", True, "Frames per second that the method can render."),
    Column("latency", "ms", False, "From capture to display: mean (95th percentile), waiting included."),
    Column("behind", "frames", False, "Latency in frames of the cameras."),
    Column("shown", "frames", None, "Frames that were displayed at some instant."),
    Column("repeated", "instants", None, "Instants at which the previous frame was still displayed."),
    Column("dropped", "frames", None, "Frames between displayed ones that were never displayed."),
    Column("nothing yet", "instants", None, "Instants at the beginning of the clip without a frame, which are not scored."),
)
SCREEN_COUNTS = ("shown", "repeated", "dropped", "dark")
LEAST_FRAMES = 100  # of a clip of which it is asked
PER_FRAMES = 100  # of which the table gives the slope
APART = "{}, apart from the scene"


def timing_table(run: MeasuredRun) -> Table:
    """Median and 95th percentile of each stage's time in milliseconds, over all views, without each view's first frame.

    Reading:
        The first frame of a view pays for caches and has no history, so it is no steady state; a run of one frame has no other
        and the caption says so.
    """
    jobs = {label: render_records(run, label) for label in run.labels}
    first = min(1, run.protocol.frames.count - 1)
    times = {label: _stage_seconds(records, first) for label, records in jobs.items()}
    stages = [*dict.fromkeys(stage for stages in times.values() for stage in stages if stage != TOTAL), TOTAL]
    columns = tuple(Column(stage, "ms", False) for stage in stages)
    rows = [run.row(label, [_stage_cell(times[label], stage) for stage in stages]) for label in run.labels]
    return Table("timing", "Time per frame", _caption(run, jobs, first), columns, tuple(rows), run.scene)


def render_records(run: MeasuredRun, label: str) -> list[dict[str, Any]]:
    """Records of the render jobs; frames that others rendered have none."""
    files = [run.folder.renders(label, view) / JOB_FILE for view in run.protocol.views.test]
    return [read_json(file) for file in files if file.is_file()]


def _stage_seconds(records: Sequence[dict[str, Any]], first: int) -> dict[str, list[float]]:
    """Return the seconds of each stage and of their sum, frames `first`.. of all views in one list."""
    stages: dict[str, list[float]] = {}
    for record in records:
        kept = {stage: values[first:] for stage, values in record.get("seconds", {}).items()}
        for stage, values in kept.items():
            stages.setdefault(stage, []).extend(values)
        if kept:
            stages.setdefault(TOTAL, []).extend(map(sum, zip(*kept.values(), strict=True)))
    return stages


def _stage_cell(stages: dict[str, list[float]], stage: str) -> Cell:
    if not stages:
        return Cell("not computed: no times recorded")
    if not stages.get(stage):
        return Cell("no such stage")
    median, p95 = np.percentile(stages[stage], [50, 95]) * 1000
    return Cell(f"{median:.1f}", float(median), beside=f"({p95:.1f})")


def _caption(run: MeasuredRun, jobs: dict[str, list[dict[str, Any]]], first: int) -> str:
    if not any(jobs.values()):
        return "No times: others rendered these frames."
    height, width = read_image(frame_path(run.folder.truth(run.protocol.views.test[0]), run.frames[0])).shape[:2]
    threads = sorted({record["threads"] for records in jobs.values() for record in records if "threads" in record})
    on = f"{' or '.join(map(str, threads))} thread{'' if threads == [1] else 's'}" if threads else "threads not recorded"
    left_out = "each view's first frame left out" if first else "of the only frame of each view"
    size = ", ".join(filter(None, (run.sources_text, f"{width} × {height}", on)))
    return f"Median (95th percentile), {left_out}; {size}; reading and writing of files excluded."


@dataclass(frozen=True)
class PublishedTime:
    """The stage here that does what one of the paper's times is of; None if there is none, with the reason."""

    stage: str | None
    why_not: str = ""


TIMINGS = {
    "forward_splatting_ms": PublishedTime("splat"),
    "tsdf_ms": PublishedTime("tsdf"),
    "blending_tensorrt_ms": PublishedTime(None, "this package does not use TensorRT"),
    "blending_no_tensorrt_ms": PublishedTime("blend"),
    "total_no_tensorrt_ms_text": PublishedTime(TOTAL),
    "total_ms_text": PublishedTime(TOTAL),
}


def evaluate_time(runs: Sequence[MeasuredRun], label: str, key: str, paper_ms: float) -> tuple[Cell | None, str]:
    """Return the time of a stage here and what it is against the paper's, or None and why there is none.

    Reading:
        A time belongs to its machine: the paper's is a GPU that it does not name, this one is the machine of the run. So it is
        set next to the paper's with the ratio of the two, and never called reproduced.
    """
    timing = TIMINGS[key]
    if timing.stage is None:
        return None, timing.why_not
    times_ms = [value for run in runs if (value := _stage_ms(run, label, timing.stage)) is not None]
    if not times_ms:
        return None, f"no time of stage {timing.stage} recorded"
    value = float(np.mean(times_ms))
    ratio = f"{value / paper_ms:.2g} times the paper's" if paper_ms else "the paper has 0"
    return Cell(f"{value:.1f}", value), f"{ratio}; median of a frame on the machine of this run, the paper's on an unnamed GPU"


def _stage_ms(run: MeasuredRun, label: str, stage: str) -> float | None:
    """Return the median milliseconds of a stage of one method; None if none were recorded."""
    table = timing_table(run)
    column = next((at for at, column in enumerate(table.columns) if column.name == stage), None)
    return None if column is None or label not in run.labels else table.rows[run.labels.index(label)].cells[column].value


def stream_table(run: MeasuredRun) -> Table | None:
    """Return one row per method; None if the protocol has no stream, or nothing was scored under it."""
    stream, file = run.protocol.stream, run.folder.stream_record
    if stream is None or not file.is_file():
        return None
    record = read_json(file)
    rows = [run.row(label, _screen_cells(record["methods"].get(label, {"absent": "not scored"}), stream)) for label in run.labels]
    scored = f"the first {stream.warm_up} not scored" if stream.warm_up else "all scored from a method's first picture on"
    stages = "stages work on different frames at once" if stream.pipelined else "one frame at a time"
    late = f" A frame later than {stream.deadline_ms:g} ms is not shown." if stream.policy == "deadline" else ""
    caption = (
        f"{run.protocol.frames.count} frames of one view at {stream.fps:g} per second, {scored}. "
        f"A method processes the newest frame when it is free ({stages}); skipped frames are dropped.{late} "
        f"Times are medians of this run (stated ones where the protocol states them), {record['depth']}."
    )
    return Table("on_time", "Displayed frames and their delay", caption, SCREEN_COLUMNS, rank(SCREEN_COLUMNS, rows), run.scene)


def _screen_cells(record: dict[str, Any], stream: Stream) -> tuple[Cell, ...]:
    stages_ms = record.get("stages_ms", {})
    whole = sum(stages_ms.values())
    depth = f"(depth {stages_ms['depth']:.1f})" if "depth" in stages_ms else ""
    time = Cell(f"{whole:.1f}", whole, beside=depth) if stages_ms else None
    if "absent" in record:
        absent = Cell("not on the screen", note=record["absent"])
        return (time or absent, *[absent] * (len(SCREEN_COLUMNS) - 1))
    rate, latency, late = record["per_second"], record["latency_ms"], record["latency_p95_ms"]
    in_frames = stream.fps / 1000
    return (
        time or Cell("0.0", 0.0),
        Cell("no limit") if rate is None else Cell(format_value(rate), rate),
        Cell(f"{latency:.0f}", latency, beside=f"({late:.0f})"),
        Cell(f"{latency * in_frames:.1f}", latency * in_frames, beside=f"({late * in_frames:.1f})"),
        *(Cell(str(record[name]), float(record[name])) for name in SCREEN_COUNTS),
    )


def drift_table(run: MeasuredRun) -> Table | None:
    """Slopes over time of the first table's metrics, of methods that are not set aside; None of clips too short to ask.

    A scene that gets harder pulls all methods down, so next to each slope is that of the difference to the mean of all methods.
    """
    labels = [label for label in run.labels if label not in run.results.set_aside]
    if run.protocol.frames.count < LEAST_FRAMES:
        return None
    notes = [note for note in run.metrics.values() if note.group == next(iter(run.metrics.values())).group]
    series = {note.name: of for note in notes if (of := _drift_series(run, note.name, labels))}
    if not series:
        return None
    shown = [run.metrics[name] for name in series]
    heads = ("{}", APART) if len(labels) > 1 else ("{}",)  # one method alone is all of the mean
    columns = [Column(head.format(note.name), note.unit, note.higher_is_better) for note in shown for head in heads]
    means = {name: np.mean(list(by_label.values()), axis=0) for name, by_label in series.items()}
    rows = []
    for label in labels:
        cells = []
        for note in shown:
            own = series[note.name].get(label)
            apart = None if own is None else own - means[note.name]
            cells += [_drift_cell(each, note) for each in (own, apart)[: len(heads)]]
        rows.append(run.row(label, cells))
    count = sum(cell.value is not None for row in rows for cell in row.cells)
    caption = (
        f"Change per {PER_FRAMES} frames of the line through the mean of the views, over {run.protocol.frames.count} frames, "
        f"with its {100 * LEVEL:.0f} % interval; apart from the scene: of the difference to the mean of all methods. Without any "
        f"drift about {max(1, round((1 - LEVEL) * count))} of these {count} intervals would exclude 0 by chance. {SHORT_MEANS}"
    )
    return Table("drift", "Drift over time", caption, tuple(columns), tuple(rows), run.scene)


def _drift_series(run: MeasuredRun, metric: str, labels: Sequence[str]) -> dict[str, Array]:
    """Return label -> value of each frame, the mean over the views, of the methods that have one in every view and frame."""
    found = {}
    for label in labels:
        try:
            panel = read_panel(run.results, metric, run.results.scenes[0], *split_label(label))
        except ResultsError:
            continue
        if len(panel.frames) == run.protocol.frames.count:
            found[label] = panel.values.mean(axis=0)
    return found


def _drift_cell(series: Array | None, note: MetricNote) -> Cell:
    if series is None:
        return Cell("not computed: no value of every frame")
    drift = measure_drift(series)
    slope, half = PER_FRAMES * drift.slope, PER_FRAMES * drift.half_width
    spread = spread_text(slope, half, note.decimals, bool(drift.short))
    return Cell(signed(slope, note.decimals), slope, False, 0.0, spread, slope - half, slope + half, drift.short)
