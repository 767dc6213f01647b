"""Table of what reaches the screen of a run: rate and latency of each method, frames shown, repeated and dropped."""

from typing import Any

from ggvs_eval.protocol import Stream
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Table, format_value, rank
from ggvs_eval.run_folder import read_json

COLUMNS = (
    Column("time of a picture", "ms", False, "Sum of the median times of its stages; of which depth, where its time counts."),
    Column("rate", "pictures/s", True, "Pictures that the method can make in a second."),
    Column("latency", "ms", False, "From the capture of a frame to its picture: mean (95th percentile), waiting included."),
    Column("behind", "frames", False, "The latency in frames of the cameras."),
    Column("shown", "frames", None, "Frames whose picture was on the screen at some instant."),
    Column("repeated", "instants", None, "Instants at which the picture of the instant before still stood there."),
    Column("dropped", "frames", None, "Frames between those that were shown whose picture never was."),
    Column("nothing yet", "instants", None, "Instants at the beginning of the clip without any picture, which are not scored."),
)
COUNTS = ("shown", "repeated", "dropped", "dark")


def stream_table(run: MeasuredRun) -> Table | None:
    """One row per method; None where the protocol has no stream, or nothing was scored under it."""
    stream, file = run.protocol.stream, run.folder.stream_record
    if stream is None or not file.is_file():
        return None
    record = read_json(file)
    rows = [run.row(label, _cells(record["methods"].get(label, {"absent": "not scored"}), stream)) for label in run.labels]
    caption = (
        f"{run.protocol.frames.count} frames of one view at {stream.fps:g} per second, {_scored(stream)}. {_policy(stream)} "
        f"Times are medians of this run (stated ones where the protocol states them), {record['depth']}."
    )
    return Table("on_time", "What reaches the screen, and when", caption, COLUMNS, rank(COLUMNS, rows), run.scene)


def _scored(stream: Stream) -> str:
    return f"the first {stream.warm_up} not scored" if stream.warm_up else "all scored from a method's first picture on"


def _policy(stream: Stream) -> str:
    """Sentence on the order in which frames are worked on."""
    stages = "stages work on different frames at once" if stream.pipelined else "one frame at a time"
    late = f" A picture later than {stream.deadline_ms:g} ms is not shown." if stream.policy == "deadline" else ""
    return f"A method takes the newest frame whenever it is free ({stages}); what it passes over is dropped.{late}"


def _cells(record: dict[str, Any], stream: Stream) -> tuple[Cell, ...]:
    stages_ms = record.get("stages_ms", {})
    whole = sum(stages_ms.values())
    depth = f"(depth {stages_ms['depth']:.1f})" if "depth" in stages_ms else ""
    time = Cell(f"{whole:.1f}", whole, beside=depth) if stages_ms else None
    if "absent" in record:
        absent = Cell("not on the screen", note=record["absent"])
        return (time or absent, *[absent] * (len(COLUMNS) - 1))
    rate, latency, late = record["per_second"], record["latency_ms"], record["latency_p95_ms"]
    in_frames = stream.fps / 1000
    return (
        time or Cell("0.0", 0.0),
        Cell("no limit") if rate is None else Cell(format_value(rate), rate),
        Cell(f"{latency:.0f}", latency, beside=f"({late:.0f})"),
        Cell(f"{latency * in_frames:.1f}", latency * in_frames, beside=f"({late * in_frames:.1f})"),
        *(Cell(str(record[name]), float(record[name])) for name in COUNTS),
    )
