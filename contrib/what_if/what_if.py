"""Scores of rendered frames as they came and with each fault undone, with intervals of what they
were without.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import ceil
from typing import Any

import numpy as np

from ggvs_eval import built_in
from ggvs_eval.contrib.what_if.undo import Undo, apply, list_undos, put_back
from ggvs_eval.errors import MetricError, RenderError
from ggvs_eval.finding import Finding
from ggvs_eval.measured_frames import measured_frame
from ggvs_eval.metrics.metric import ViewMetric
from ggvs_eval.metrics.registry import METRICS, select_metrics
from ggvs_eval.metrics.stream import score_views
from ggvs_eval.pipelines.inspection.renders.examine import examine, explain_loss
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.pipelines.inspection.table import text_table
from ggvs_eval.pipelines.run.score_view import metric_options
from ggvs_eval.protocol import Measurement
from ggvs_eval.run_folder import as_ranges
from ggvs_eval.scoring import FrameReader

FEWEST_FRAMES = 8  # four to estimate on, fewer do not distinguish neighbouring instants
HONEST, ALL = "as handed in", "all of these"
TINY = 1e-12
Film = Mapping[str, ViewFrames]


@dataclass(frozen=True)
class Score:
    """A number of one row.

    Attributes:
        value: mean over frames, then views.
        low: lower end of where the number of frames without the fault is, see `score_undone`.
        high: upper end.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Row:
    """Frames under one treatment.

    Attributes:
        words: what was done to them.
        undos: the faults that it undoes.
        scores: metric -> number; without those that were not computed.
    """

    words: str
    undos: tuple[Undo, ...]
    scores: Mapping[str, Score]

    @property
    def faults(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(undo.fault for undo in self.undos)


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
        loss: whether any fault is known that explains the PSNR; empty if one was found.
    """

    rows: tuple[Row, ...]
    estimated_on: tuple[int, ...]
    scored_on: tuple[int, ...]
    views: int
    border_px: int
    stays: tuple[Finding, ...]
    not_computed: Mapping[str, str]
    loss: str = ""

    @property
    def best(self) -> Row:
        """The row that is best in its first metric, of equal ones that with the most faults
        undone.
        """

        def merit(row: Row) -> tuple[list[float], int]:
            first = list(row.scores.items())[:1]
            return [
                score.value if METRICS[metric].higher_is_better else -score.value
                for metric, score in first
            ], len(row.undos)

        return max(self.rows, key=merit)

    def record(self) -> dict[str, Any]:
        """The same as JSON values."""
        rows = []
        for row in self.rows:
            scores = {metric: asdict(score) for metric, score in row.scores.items()}
            rows.append({"words": row.words, "faults": row.faults, "scores": scores})
        return asdict(replace(self, rows=())) | {"rows": rows}


def what_if(
    views: Mapping[str, ViewFrames],
    cameras: Mapping[str, FrameReader],
    measurement: Measurement,
    metrics: Sequence[str],
) -> WhatIf:
    """Undo each fault of rendered frames and score them again.

    Args:
        views: rendered and captured frames of each view, all of the same numbers.
        cameras: captured frames of further cameras.
        measurement: how frames are measured; its metrics are not used.
        metrics: names of metrics that compare single frames.

    Reading:
        The middle half of the frames says what is wrong and by how much; the first and the last
        quarter are scored. Neighbours share most of their picture, but a shift that fits noise of
        the middle does not fit theirs. All of several faults have a row if that is at least as good
        as each of them alone in the first metric.

        Undone frames differ from those without the fault in two ways. The parameters of the fault
        are known within an interval: the frames are scored with each of them at its ends. And what
        was rounded, clipped or interpolated is lost: they are scored with as many errors less or
        more. An interval adds up by how much these scores differ from the value, at the first and
        the last instant.
    """
    frames = next(iter(views.values())).frames
    if len(frames) < FEWEST_FRAMES:
        raise RenderError(
            f"wanted {FEWEST_FRAMES} frames or more, half to estimate on, half to score; got "
            f"{len(frames)}; render more"
        )
    metrics, quarter = _frame_metrics(metrics), len(frames) // 4
    middle = range(frames.start + quarter, frames.stop - quarter)
    halves = {
        name: ViewFrames(
            rendered=view.rendered, truth=view.truth, frames=middle, truth_frames=view.truth_range
        )
        for name, view in views.items()
    }
    undos, stays = list_undos(examine(halves, cameras), halves)
    if not undos:
        return WhatIf(
            rows=(),
            estimated_on=tuple(middle),
            scored_on=(),
            views=len(views),
            border_px=0,
            stays=tuple(stays),
            not_computed={},
            loss="" if stays else explain_loss(views),
        )
    treatments = [(), *((undo,) for undo in undos), *([tuple(undos)] if len(undos) > 1 else [])]
    treated = [_treat(views, treatment) for treatment in treatments]
    shared = [
        i
        for i in frames
        if i not in middle and all(i in view.frames for film in treated for view in film.values())
    ]
    if not shared:
        raise RenderError(
            f"{len(frames)} frames leave none that every row can score; render more than twice the "
            f"offset"
        )
    border_px = max(way.border_px for undo in undos for way in undo.ways.values())
    values, not_computed = _score(treated, shared, border_px, measurement, metrics)
    rows = []
    for treatment, film, of_row in zip(treatments, treated, values, strict=True):
        films = [film, *_alternatives(views, treatment, film)]
        moved, _ = _score(films, sorted({shared[0], shared[-1]}), border_px, measurement, metrics)
        scores = {
            metric: _within(value, [row[metric] for row in moved])
            for metric, value in of_row.items()
        }
        words = (
            f"{treatment[0].words()} ({treatment[0].verdict})"
            if len(treatment) == 1
            else ALL
            if treatment
            else HONEST
        )
        rows.append(Row(words, treatment, scores))
    outcome = WhatIf(
        rows=tuple(rows),
        estimated_on=tuple(middle),
        scored_on=tuple(shared),
        views=len(views),
        border_px=border_px,
        stays=tuple(stays),
        not_computed=not_computed,
    )
    return (
        replace(outcome, rows=outcome.rows[:-1])
        if len(undos) > 1 and outcome.best is not rows[-1]
        else outcome
    )


def _treat(views: Mapping[str, ViewFrames], undos: Sequence[Undo]) -> Film:
    return {name: apply(undos, name, view) for name, view in views.items()}


def _alternatives(views: Mapping[str, ViewFrames], undos: Sequence[Undo], film: Film) -> list[Film]:
    """Return what frames without the fault may be: with what was lost, rightly or wrongly, and by
    parameters at their ends.
    """
    if all(way.is_exact for undo in undos for way in undo.ways.values()):
        return []
    films: list[Film] = [
        {name: _put_back(view, undos, name, sign) for name, view in film.items()}
        for sign in (-1, 1, 0)
    ]
    for at, undo in enumerate(undos):
        n_ends = max(len(way.at_ends) for way in undo.ways.values())
        films += [
            _treat(views, [*undos[:at], undo.at_end(number), *undos[at + 1 :]])
            for number in range(n_ends)
        ]
    return films


def _put_back(view: ViewFrames, undos: Sequence[Undo], name: str, sign: int) -> ViewFrames:
    return replace(
        view,
        rendered=lambda index: put_back(undos, name, view.rendered(index), view.truth(index), sign),
    )


def _within(value: float, scores: Sequence[float]) -> Score:
    """A value with its interval, from the first score, three with what was lost, and pairs at the
    ends of parameters.
    """
    if len(scores) == 1:
        return Score(value, value, value)
    fewer, more, sharper, *ends = np.array(scores[1:]) - scores[0]
    lost = fewer, more, -more, sharper, 0.0  # a few errors less gain what as many more cost
    below, above = np.reshape(ends, (-1, 2)).T
    slope, bend = (above - below) / 2, (above + below) / 2
    # The score is a parabola of the parameter, whose vertex may be within the interval.
    vertex = np.where(np.abs(slope) < 2 * np.abs(bend), -(slope**2) / (4 * bend + TINY), 0.0)
    extremes = np.stack([below, above, vertex])
    low = min(lost) - float(np.hypot.reduce(extremes.min(axis=0), initial=0.0))
    high = max(lost) + float(np.hypot.reduce(extremes.max(axis=0), initial=0.0))
    return Score(value, value + low, value + high)


def _score(
    films: Sequence[Film],
    instants: Sequence[int],
    border_px: int,
    measurement: Measurement,
    metrics: Sequence[str],
) -> tuple[list[dict[str, float]], dict[str, str]]:
    """Measure films of the same views, and say which metrics cannot be measured."""
    values: dict[tuple[int, str], list[float]] = {}
    not_computed: dict[str, str] = {}
    for name, view in films[0].items():
        pictures = (
            (
                [_cut(film[name].rendered(i), border_px, measurement) for film in films],
                _cut(view.truth(i), border_px, measurement),
            )
            for i in instants
        )
        for number, scored in enumerate(
            score_views(pictures, metrics, metric_options(measurement))
        ):
            not_computed |= scored.not_computed
            for metric, _, value in scored.values:
                values.setdefault((number, metric), []).append(value)
    computed = [metric for metric in metrics if metric not in not_computed]
    means = [
        {metric: float(np.mean(values[number, metric])) for metric in computed}
        for number in range(len(films))
    ]
    return means, not_computed


def _frame_metrics(names: Sequence[str]) -> tuple[str, ...]:
    """Refuse metrics of whole views, of a part of the picture and of corrected colours."""
    selected = select_metrics(names)
    unfit = [
        metric.name
        for metric in selected
        if not (
            isinstance(metric, ViewMetric)
            and metric.kind == "frame"
            and not metric.corrects_colours
            and metric.pooling is ViewMetric.pooling
        )
        or metric.name.rpartition("_")[2] in built_in.REGIONS
    ]
    if unfit:
        raise MetricError(
            f"--metrics: wanted metrics of single frames, e.g. PSNR SSIM LPIPS, got "
            f"{', '.join(unfit)}; leave it out"
        )
    return tuple(metric.name for metric in selected)


def _cut(image: Any, border_px: int, measurement: Measurement) -> Any:
    """A frame as it is measured, without the border."""
    height = image.shape[0]
    scaled = measured_frame(image, measurement)
    border = ceil(border_px * max(scaled.shape[0] / height, 1 / height))
    rows, columns = scaled.shape[:2]
    if min(rows, columns) - 2 * border < 16:
        raise RenderError(
            f"frames of {columns} x {rows} px leave nothing within a border of {border} px; the "
            f"shift is too large"
        )
    return scaled[border : rows - border, border : columns - border]


def what_if_text(label: str, outcome: WhatIf) -> str:
    """Write the rows as a table, and what they stand on."""
    where = f"frames {as_ranges(list(outcome.estimated_on))}"
    stays = "".join(
        f"; {finding.question} of {finding.subject} stays ({finding.verdict})"
        for finding in outcome.stays
    )
    if not outcome.rows:
        return (
            f"{label}: nothing to undo in {where} of {outcome.views} views; "
            f"{outcome.loss or stays[2:]}"
        )
    metrics = list(outcome.rows[0].scores)
    lines = [
        [row.words, *(cell_text(metric, row.scores[metric]) for metric in metrics)]
        for row in outcome.rows
    ]
    return "\n".join(
        [
            f"{label}: no result: scores without the fault. Estimated on {where}, scored on "
            f"{as_ranges(list(outcome.scored_on))} of {outcome.views} views, {outcome.border_px} "
            f"px cut off at each side{stays}",
            text_table({"frames": 1, **dict.fromkeys(metrics, 0)}, lines),
            "in brackets the 95 % interval of the score without the fault, where it is not exact",
            *(f"{metric}: {reason}" for metric, reason in outcome.not_computed.items()),
        ]
    )


def cell_text(metric: str, score: Score) -> str:
    """Write a number, and in brackets its interval where it has one."""
    digits = METRICS[metric].decimals if METRICS[metric].decimals is not None else 3
    text = f"{score.value:.{digits}f}"
    return (
        text
        if score.low == score.high
        else f"{text} [{score.low:.{digits}f}, {score.high:.{digits}f}]"
    )
