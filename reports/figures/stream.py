"""What reaches the screen of a live viewer: rate, latency and lost frames of each method, and what
delay costs.

The drawing has the score of the displayed frames over pictures per second, and the score if every
frame were waited for.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.errors import ResultsError
from ggvs_eval.protocol import Stream
from ggvs_eval.reports.figures.axes import COLOURS, Panel, method_numbers, save_figure, with_margin
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Table, format_value, rank
from ggvs_eval.results import label_of, without_option
from ggvs_eval.run_folder import ON_SCREEN, read_json

DRAWN = ("PSNR", "LPIPS", "TCC")
RATE_PANEL_IN = (3.4, 2.6)
A_STREAM_SWEEP = "make one with `ggvs-eval sweep stream FOLDER --capture CAPTURE`"
SCREEN_COLUMNS = (
    Column(
        name="time of a picture",
        unit="ms",
        higher_is_better=False,
        describe="Sum of the median times of its stages, depth included where its time counts.",
    ),
    Column(
        name="rate",
        unit="pictures/s",
        higher_is_better=True,
        describe="Frames per second that the method can render.",
    ),
    Column(
        name="latency",
        unit="ms",
        higher_is_better=False,
        describe="From capture to display: mean (95th percentile), waiting included.",
    ),
    Column(
        name="behind",
        unit="frames",
        higher_is_better=False,
        describe="Latency in frames of the cameras.",
    ),
    Column(
        name="shown",
        unit="frames",
        higher_is_better=None,
        describe="Frames that were displayed at some instant.",
    ),
    Column(
        name="repeated",
        unit="instants",
        higher_is_better=None,
        describe="Instants at which the previous frame was still displayed.",
    ),
    Column(
        name="dropped",
        unit="frames",
        higher_is_better=None,
        describe="Frames between displayed ones that were never displayed.",
    ),
    Column(
        name="nothing yet",
        unit="instants",
        higher_is_better=None,
        describe="Instants at the beginning of the clip without a frame, which are not scored.",
    ),
)
SCREEN_COUNTS = ("shown", "repeated", "dropped", "dark")


@dataclass(frozen=True)
class Mark:
    """One method at one size and K: pictures per second, the number on the screen, and the number
    where each is waited for.
    """

    title: str
    per_second: float
    seen: float
    waited: float


@dataclass(frozen=True)
class Family:
    """A method at all sizes and K, slowest first."""

    name: str
    marks: tuple[Mark, ...]


@dataclass(frozen=True)
class RatePanel:
    """One metric over pictures per second, on a logarithmic axis.

    Attributes:
        axes: metric, unit and direction; its places across are decimal logarithms of the rate.
        fps: rate of the cameras, which a method must reach to show every frame.
        families: one per method.
    """

    axes: Panel
    fps: float
    families: tuple[Family, ...]

    def x(self, per_second: float) -> float:
        """Return the horizontal place of a rate in the drawing, in its pixels."""
        return self.axes.x(math.log10(per_second))

    def line(self, family: Family) -> str:
        """Displayed quality of a method, as the points of an SVG polyline."""
        return " ".join(
            f"{self.x(mark.per_second)},{self.axes.y(mark.seen)}" for mark in family.marks
        )


def rate_panels(runs: Sequence[MeasuredRun]) -> tuple[RatePanel, ...]:
    """Return a panel per metric of runs that differ in K alone, or of one.

    None if nothing is on a screen.
    """
    streams = {run.protocol.stream for run in runs}
    (stream,) = streams if len(streams) == 1 else (None,)
    if stream is None:
        return ()
    return tuple(panel for metric in DRAWN if (panel := _panel(runs, metric, stream.fps)))


def _panel(runs: Sequence[MeasuredRun], metric: str, fps: float) -> RatePanel | None:
    note = next((run.metrics[metric] for run in runs if metric in run.metrics), None)
    if note is None:
        return None
    marks: dict[str, list[Mark]] = {}
    names: dict[str, str] = {}
    for run in runs:
        for label, mark in _marks(run, metric, several=len(runs) > 1):
            family = without_option(label, "scale")
            marks.setdefault(family, []).append(mark)
            names.setdefault(family, run.name(family))
    every = [mark for of_family in marks.values() for mark in of_family]
    if not every:
        return None
    families = [
        Family(names[label], tuple(sorted(of_family, key=lambda mark: mark.per_second)))
        for label, of_family in marks.items()
    ]
    rates = [fps, *(mark.per_second for mark in every)]
    values = [value for mark in every for value in (mark.seen, mark.waited)]
    bounds = (
        math.log10(min(rates)) - 0.08,
        math.log10(max(rates)) + 0.08,
        *with_margin(min(values), max(values)),
    )
    better = "higher is better" if note.higher_is_better else "lower is better"
    return RatePanel(
        Panel(metric=metric, unit=note.unit, better=better, view="", curves=(), bounds=bounds),
        fps,
        tuple(families),
    )


def _marks(run: MeasuredRun, metric: str, several: bool) -> list[tuple[str, Mark]]:
    """Return the methods of a run that have a rate and both numbers."""
    file = run.folder.stream_record
    records = read_json(file)["methods"] if file.is_file() else {}
    summary = (run.all_results or run.results).summary().droplevel("dataset")
    values = {label_of(*names): summary.loc[names] for names in summary.index}
    at_k = f", K = {run.protocol.synthesis.k}" if several else ""
    marks = []
    for label in run.labels:
        per_second = records.get(label, {}).get("per_second")
        displayed, waited = (
            float(values.get(row, {}).get(metric, math.nan))
            for row in (f"{label}{ON_SCREEN}", label)
        )
        if per_second and math.isfinite(displayed) and math.isfinite(waited):
            marks.append(
                (
                    label,
                    Mark(
                        title=f"{run.name(label)}{at_k}",
                        per_second=per_second,
                        seen=displayed,
                        waited=waited,
                    ),
                )
            )
    return marks


def draw_rates(
    panels: Sequence[RatePanel], out: Path, numbers: Mapping[str, int] | None = None
) -> Path:
    """Draw the panels side by side, for print, in the colours of `numbers`, see `method_numbers`.

    Raises:
        ResultsError: no panels.
    """
    from matplotlib.figure import Figure

    if not panels:
        raise ResultsError(f"{out}: no method is on a screen in these runs; {A_STREAM_SWEEP}")
    figure = Figure(
        figsize=(RATE_PANEL_IN[0] * len(panels), RATE_PANEL_IN[1]), layout="constrained"
    )
    numbers = numbers or method_numbers(
        family.name for panel in panels for family in panel.families
    )
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        axes.set_xscale("log")
        axes.axvline(
            panel.fps, color="#999999", linewidth=0.8, linestyle=":", label="rate of the cameras"
        )
        for family in panel.families:
            colour, rates = (
                COLOURS[numbers[family.name] % len(COLOURS)],
                [mark.per_second for mark in family.marks],
            )
            axes.plot(
                rates,
                [mark.seen for mark in family.marks],
                "o-",
                color=colour,
                markersize=4,
                label=family.name,
                linewidth=1,
            )
            axes.plot(
                rates,
                [mark.waited for mark in family.marks],
                "o",
                color=colour,
                markersize=4,
                fillstyle="none",
            )
            for mark in family.marks:
                axes.plot(
                    [mark.per_second] * 2,
                    [mark.seen, mark.waited],
                    color=colour,
                    linewidth=0.5,
                    alpha=0.5,
                )
        unit = f" ({panel.axes.unit})" if panel.axes.unit else ""
        axes.set_ylabel(f"{panel.axes.metric}{unit} as displayed", fontsize=7)
        axes.set_xlabel("pictures per second", fontsize=7)
        texts = [text for _, text in panel.axes.logarithmic_ticks()]
        axes.set_xticks([float(text) for text in texts], texts)
        axes.set_xticks([], minor=True)
        axes.tick_params(labelsize=6)
        axes.grid(alpha=0.25, linewidth=0.5)
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=4,
        fontsize=6,
        frameon=False,
    )
    return save_figure(figure, out)


def stream_table(run: MeasuredRun) -> Table | None:
    """Return one row per method.

    None if the protocol has no stream, or nothing was scored under it.
    """
    stream, file = run.protocol.stream, run.folder.stream_record
    if stream is None or not file.is_file():
        return None
    record = read_json(file)
    rows = [
        run.row(
            label, _screen_cells(record["methods"].get(label, {"absent": "not scored"}), stream)
        )
        for label in run.labels
    ]
    scored = (
        f"the first {stream.warm_up} not scored"
        if stream.warm_up
        else "all scored from a method's first picture on"
    )
    stages = (
        "stages work on different frames at once" if stream.pipelined else "one frame at a time"
    )
    late = (
        f" A frame later than {stream.deadline_ms:g} ms is not shown."
        if stream.policy == "deadline"
        else ""
    )
    caption = (
        f"{run.protocol.frames.count} frames of one view at {stream.fps:g} per second, {scored}. A "
        f"method processes the newest frame when it is free ({stages}); skipped frames are "
        f"dropped.{late} Times are medians of this run (stated ones where the protocol states "
        f"them), {record['depth']}."
    )
    return Table(
        key="on_time",
        title="Displayed frames and their delay",
        caption=caption,
        columns=SCREEN_COLUMNS,
        rows=rank(SCREEN_COLUMNS, rows),
        dataset=run.scene,
    )


def _screen_cells(record: dict[str, Any], stream: Stream) -> tuple[Cell, ...]:
    stages_ms = record.get("stages_ms", {})
    total = sum(stages_ms.values())
    depth = f"(depth {stages_ms['depth']:.1f})" if "depth" in stages_ms else ""
    time = Cell(f"{total:.1f}", total, beside=depth) if stages_ms else None
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
