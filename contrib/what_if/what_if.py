"""Scores of rendered frames as they came and with each fault undone, with paired intervals of the differences."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import ceil
from typing import Any

from ggvs_eval import built_in
from ggvs_eval.contrib.what_if.undo import Undo, apply, list_undos
from ggvs_eval.errors import MetricError, RenderError
from ggvs_eval.finding import Finding
from ggvs_eval.measured_frames import measured_frame
from ggvs_eval.metrics.metric import ViewMetric
from ggvs_eval.metrics.registry import METRICS, pooling_records, select_metrics
from ggvs_eval.metrics.stream import score_view
from ggvs_eval.pipelines.inspection.renders.examine import examine
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.pipelines.inspection.table import text_table
from ggvs_eval.pipelines.run.score_view import metric_options
from ggvs_eval.protocol import Measurement
from ggvs_eval.results import Results, make_table
from ggvs_eval.run_folder import as_ranges
from ggvs_eval.scoring import FrameReader
from ggvs_eval.statistics.paired import Comparison, compare

FEWEST_FRAMES = 8  # four to estimate on, fewer do not distinguish neighbouring instants
HONEST, ALL = "as handed in", "all of these"
PLACE = "what-if"
Estimate = tuple[list[Undo], list[Finding], range]  # see `estimate`


@dataclass(frozen=True)
class Score:
    """A number of one row.

    Attributes:
        value: mean over frames, then views.
        gain: difference to the row of the frames as they came, with its paired interval; None in that row itself.
    """

    value: float
    gain: Comparison | None


@dataclass(frozen=True)
class Row:
    """Frames under one treatment.

    Attributes:
        words: what was done to them.
        faults: what that undoes.
        exact: whether no value was interpolated or rounded for it.
        scores: metric -> number; without those that were not computed.
    """

    words: str
    faults: tuple[str, ...]
    exact: bool
    scores: Mapping[str, Score]


def estimate(views: Mapping[str, ViewFrames], cameras: Mapping[str, FrameReader]) -> Estimate:
    """Return what undoes the faults of the middle half of the frames, in order; what cannot be undone; that half's numbers."""
    frames = next(iter(views.values())).frames
    if len(frames) < FEWEST_FRAMES:
        raise RenderError(
            f"wanted {FEWEST_FRAMES} frames or more, half to estimate on, half to score; got {len(frames)}; render more"
        )
    quarter = len(frames) // 4
    middle = range(frames.start + quarter, frames.stop - quarter)
    halves = {name: ViewFrames(view.rendered, view.truth, middle, view.truth_range) for name, view in views.items()}
    return *list_undos(examine(halves, cameras), halves), middle


@dataclass(frozen=True)
class WhatIf:
    """What frames would score without the faults of their handling.

    Attributes:
        rows: the frames as they came first; empty if no fault was found that can be undone.
        estimated_on: frames that the faults were looked for and measured on.
        scored_on: instants that every row is scored on; of other frames.
        views: how many.
        border_px: cut off at each side in every row.
        stays: faults that cannot be undone.
        not_computed: metric -> reason.
    """

    rows: tuple[Row, ...]
    estimated_on: tuple[int, ...]
    scored_on: tuple[int, ...]
    views: int
    border_px: int
    stays: tuple[Finding, ...]
    not_computed: Mapping[str, str]

    def record(self) -> dict[str, Any]:
        """The same as JSON values."""
        return asdict(self)


def what_if(
    views: Mapping[str, ViewFrames], cameras: Mapping[str, FrameReader], measurement: Measurement, metrics: Sequence[str]
) -> WhatIf:
    """Undo each fault of rendered frames and score them again.

    Args:
        views: rendered and captured frames of each view, all of the same numbers.
        cameras: captured frames of further cameras.
        measurement: how frames are measured; its metrics are not used.
        metrics: names of metrics that compare single frames.

    Reading:
        The middle half of the frames says what is wrong and by how much; the first and the last quarter are scored. Neighbours
        share most of their picture, but a shift that fits noise of the middle does not fit theirs.
    """
    metrics = _frame_metrics(metrics)
    return score_undone(views, estimate(views, cameras), measurement, metrics)


def score_undone(
    views: Mapping[str, ViewFrames],
    found: Estimate,
    measurement: Measurement,
    metrics: Sequence[str],
    together: str = ALL,
) -> WhatIf:
    """Score frames as they came and with each fault undone, on other frames than the faults were estimated on.

    Args:
        together: what the row with every fault undone is called, of several.
    """
    frames, (undos, stays, middle) = next(iter(views.values())).frames, found
    if not undos:
        return WhatIf((), tuple(middle), (), len(views), 0, tuple(stays), {})
    treatments = _treatments(undos, together)
    treated = [{name: apply(one.undos, name, view, one.on_truth) for name, view in views.items()} for one in treatments]
    shared = [i for i in frames if i not in middle and all(i in view.frames for each in treated for view in each.values())]
    if not shared:
        raise RenderError(f"{len(frames)} frames leave none that every row can score; render more than twice the offset")
    border_px = max(way.border_px for undo in undos for way in undo.ways.values())
    table: list[tuple[Any, ...]] = []
    not_computed: dict[str, str] = {}
    options = metric_options(measurement)
    for number, each in enumerate(treated):
        for name, view in each.items():
            pairs = (
                (_cut(view.rendered(i), border_px, measurement), _cut(view.truth(i), border_px, measurement)) for i in shared
            )
            scored = score_view(pairs, metrics, options)
            not_computed |= scored.not_computed
            values = [(shared[at], metric, value) for metric, at, value in scored.values if at is not None]
            table += [(PLACE, PLACE, str(number), "", name, *one) for one in values]
    results = Results(make_table(table), {"protocol_sha256": "", "pooling": pooling_records(metrics, options)})
    there = [metric for metric in metrics if metric not in not_computed]
    rows = tuple(_row(results, number, one, there) for number, one in enumerate(treatments))
    return WhatIf(rows, tuple(middle), tuple(shared), len(views), border_px, tuple(stays), not_computed)


@dataclass(frozen=True)
class _Treatment:
    words: str
    undos: tuple[Undo, ...] = ()
    on_truth: bool = False


def _treatments(undos: Sequence[Undo], together: str) -> list[_Treatment]:
    """None, each fault, and all of them; where renders are interpolated also the truth instead of them."""
    listed = [_Treatment(HONEST)]
    for undo in undos:
        listed.append(_Treatment(f"{undo.words()} ({undo.verdict})", (undo,)))
        if undo.of_truth:
            listed.append(_Treatment(f"{undo.words(on_truth=True)} ({undo.verdict})", (undo,), on_truth=True))
    if len(undos) > 1:
        listed.append(_Treatment(together, tuple(undos)))
        if any(undo.of_truth for undo in undos):
            listed.append(_Treatment(f"{together}, the truth resampled instead", tuple(undos), on_truth=True))
    return listed


def _row(results: Results, number: int, treatment: _Treatment, metrics: Sequence[str]) -> Row:
    summary = results.summary()
    values = {metric: float(summary[metric].to_numpy()[number]) for metric in metrics}
    scores = {}
    for metric, value in values.items():
        gain = replace(compare(results, metric, str(number), "0", PLACE), spread=None) if number else None  # plain numbers
        scores[metric] = Score(value, gain)
    return Row(
        treatment.words,
        tuple(undo.fault for undo in treatment.undos),
        all(way.is_exact for undo in treatment.undos for way in undo.ways.values()),
        scores,
    )


def _frame_metrics(names: Sequence[str]) -> tuple[str, ...]:
    """Refuse metrics of whole views, of a part of the picture and of corrected colours."""
    selected = select_metrics(names)
    other = [
        one.name
        for one in selected
        if not (isinstance(one, ViewMetric) and one.kind == "frame" and not one.corrects_colours)
        or one.name.rpartition("_")[2] in built_in.REGIONS
    ]
    if other:
        raise MetricError(
            f"--metrics: wanted metrics of single frames, e.g. PSNR SSIM LPIPS, got {', '.join(other)}; leave it out"
        )
    return tuple(one.name for one in selected)


def _cut(image: Any, border_px: int, measurement: Measurement) -> Any:
    """A frame as it is measured, without the border."""
    height = image.shape[0]
    measured = measured_frame(image, measurement)
    border = ceil(border_px * max(measured.shape[0] / height, 1 / height))
    rows, columns = measured.shape[:2]
    if min(rows, columns) - 2 * border < 16:
        raise RenderError(f"frames of {columns} x {rows} px leave nothing within a border of {border} px; the shift is too large")
    return measured[border : rows - border, border : columns - border]


def what_if_text(label: str, found: WhatIf) -> str:
    """Write the rows as a table, and what they stand on."""
    where = f"frames {as_ranges(list(found.estimated_on))}"
    stays = "".join(f"; {one.question} of {one.subject} stays ({one.verdict})" for one in found.stays)
    if not found.rows:
        return f"{label}: no fault found that can be undone, in {where} of {found.views} views{stays}"
    metrics = list(found.rows[0].scores)
    lines = [[row.words, *(cell_text(metric, row.scores[metric]) for metric in metrics)] for row in found.rows]
    notes = [one.gain.note for row in found.rows for one in row.scores.values() if one.gain and one.gain.note]
    rounding = "; resampled or rounded to 8 bit: " + ", ".join(
        dict.fromkeys(fault for row in found.rows if len(row.faults) == 1 and not row.exact for fault in row.faults)
    )
    return "\n".join(
        [
            f"{label}: no result: scores without the fault. Estimated on {where}, scored on {as_ranges(list(found.scored_on))} "
            f"of {found.views} views, {found.border_px} px cut off at each side{stays}",
            text_table({"frames": 1, **dict.fromkeys(metrics, 0)}, lines),
            f"in brackets the difference to the first row and its 95 % interval{rounding if rounding[-2:] != ': ' else ''}",
            *([f"note: {max(notes, key=len)}"] if notes else []),
            *(f"{metric}: {reason}" for metric, reason in found.not_computed.items()),
        ]
    )


def cell_text(metric: str, score: Score) -> str:
    """Write a number, and in brackets its difference to the first row with the interval."""
    digits = METRICS[metric].decimals if METRICS[metric].decimals is not None else 3
    text, gain = f"{score.value:.{digits}f}", score.gain
    if gain is None:
        return text
    bounds = "" if gain.low is None or gain.high is None else f" [{gain.low:+.{digits}f}, {gain.high:+.{digits}f}]"
    return f"{text} ({gain.difference:+.{digits}f}{bounds})"
