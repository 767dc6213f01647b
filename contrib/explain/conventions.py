"""Conventions of a metric as lists: measures of prepared frames, poolings, scales; and one loop.

A pooling makes one number of the values in all frames of all views.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames

ALL_VIEWS = "all views"
Levels = NDArray[Any]  # of 8 bit or not
Values = NDArray[np.float64]
MaskReader = Callable[[int], NDArray[np.bool_]]
Views = Mapping[str, ViewFrames]
Masks = Mapping[str, MaskReader]
# Of a rendered and a true frame, and of a mask where these are masked.
FrameMeasure = Callable[..., float]
Preparation = Callable[..., tuple[Levels, Levels]]
# Name of a measure -> view -> its value in each frame, (T,).
Series = Mapping[str, Mapping[str, Values]]
UNSCALED: Mapping[str, float] = {"": 1}
# Parts of a clip that values are quoted of.
PARTS = {
    "without the first frame": slice(1, None),
    "without the last frame": slice(-1),
    "the first frame alone": slice(1),
    "the last frame alone": slice(-1, None),
    **{f"the first {n} frames": slice(n) for n in (10, 50, 60, 100, 150)},
    **{
        f"every {word} frame": slice(None, None, step)
        for step, word in ((2, "second"), (5, "fifth"), (8, "eighth"), (10, "tenth"))
    },
    "every second frame, from the second": slice(1, None, 2),
}


MOST_FRAMES, MOST_STEP = 64, 13


@dataclass(frozen=True)
class Recomputed:
    """A convention and its values.

    Attributes:
        values: ``all views`` or the name of a view -> number.
        is_ours: whether it is this tool's convention.
        is_rare: whether it is tried only where no other one gives the number, since many of its
            kind are.
    """

    name: str
    values: Mapping[str, float]
    is_ours: bool = False
    is_rare: bool = False


@dataclass(frozen=True)
class Pooling:
    """One number of the values in all frames of some views.

    Attributes:
        name: in words; empty for the usual one.
        pool: values in the frames of each view -> number.
        is_of_views: whether it says something of each of several views alone.
        least_views: fewer of them have another name for the same number.
    """

    name: str
    pool: Callable[[Sequence[Values]], float | np.floating]
    is_of_views: bool = True
    least_views: int = 1


def over_views(
    name: str,
    of_view: Callable[[Values], Any] = np.mean,
    least_views: int = 1,
) -> Pooling:
    """Return the mean over the views of a number of each, as of its mean over the frames."""

    def pool(views: Sequence[Values]) -> np.floating:
        return np.mean([of_view(values) for values in views])

    return Pooling(name, pool, least_views=least_views)


MEAN = over_views("")


def conventions(
    series: Series,
    poolings: Iterable[Pooling] = (MEAN,),
    divisors: Mapping[str, float] = UNSCALED,
    own_name: str = "",
) -> list[Recomputed]:
    """Pool each series in each way, and write the result on each scale.

    Args:
        divisors: name of a scale -> what values are divided by.
        own_name: full name of this tool's convention.
    """
    rows = []
    for name, by_view in series.items():
        for pooling in poolings:
            if len(by_view) < pooling.least_views:
                continue
            pooled = {ALL_VIEWS: pooling.pool(list(by_view.values()))}
            if pooling.is_of_views or len(by_view) == 1:
                pooled |= {view: pooling.pool([values]) for view, values in by_view.items()}
            for scale, divisor in divisors.items():
                title = ", ".join(filter(None, (name, pooling.name, scale)))
                values = {over: float(value / divisor) for over, value in pooled.items()}
                rows.append(Recomputed(title, values, title == own_name))
    return rows


def _mean_of_part(title: str, part: slice) -> Pooling:
    return over_views(title, lambda values: np.mean(values[part]))


def conventions_in_parts(
    series: Series,
    divisors: Mapping[str, float] = UNSCALED,
) -> list[Recomputed]:
    """Means over parts of the frames, see `PARTS`; of equal ones in a short clip the first."""
    lengths = [len(values) for by_view in series.values() for values in by_view.values()]
    rows, parts_tried = [], [[range(length) for length in lengths]]
    for title, part in PARTS.items():
        frames = [range(length)[part] for length in lengths]
        if all(frames) and frames not in parts_tried:
            parts_tried.append(frames)
            rows += conventions(series, [_mean_of_part(title, part)], divisors)
    for title, part in _rare_parts(min(lengths, default=0)):
        if [range(length)[part] for length in lengths] not in parts_tried:
            of_part = conventions(series, [_mean_of_part(title, part)], divisors)
            rows += [replace(row, is_rare=True) for row in of_part]
    return rows


def _rare_parts(length: int) -> Iterator[tuple[str, slice]]:
    """Yield the parts of a clip that have no usual number of frames."""
    for count in range(2, min(length, MOST_FRAMES)):
        yield f"the first {count} frames", slice(count)
        yield f"the last {count} frames", slice(-count, None)
    for step in range(3, min(length, MOST_STEP)):
        yield f"one frame in {step}", slice(None, None, step)


def frame_means(
    views: Views,
    measures: Mapping[str, FrameMeasure],
    own_name: str,
    in_parts: Iterable[str] | None = None,
    divisors: Mapping[str, float] = UNSCALED,
) -> list[Recomputed]:
    """Measures of single frames, mean over the frames of a view, then over the views.

    Args:
        in_parts: measures that are taken of parts of the clip too; this tool's own by default.
    """
    series = measured(views, measures)
    parts = {name: series[name] for name in in_parts or [own_name] if name in series}
    full_name = ", ".join(filter(None, (own_name, next(iter(divisors)))))
    rows = conventions(series, divisors=divisors, own_name=full_name)
    return rows + conventions_in_parts(parts, divisors)


def measured(
    views: Views,
    measures: Mapping[str, FrameMeasure],
    masks: Masks | None = None,
) -> Series:
    """Take measures of each frame.

    Args:
        masks: of frames that are masked; views without are left out.
    """
    if masks is not None:
        views = {name: view for name, view in views.items() if name in masks}
    by_view: dict[str, list[dict[str, float]]] = {}
    for view, frames in views.items():
        inputs = view_pairs(frames) if masks is None else _masked(frames, masks[view])
        by_view[view] = []
        for frame in inputs:
            values = {name: measure(*frame) for name, measure in measures.items()}
            by_view[view].append(values)
    return series_of(by_view)


def series_of(by_view: Mapping[str, Iterable[Mapping[str, float | None]]]) -> Series:
    """Return as series what is known of each frame; without measures that some view never has."""
    series: dict[str, dict[str, list[float]]] = {}
    for view, frames in by_view.items():
        for frame in frames:
            for name, value in frame.items():
                by_name = series.setdefault(name, {})
                if value is not None:
                    by_name.setdefault(view, []).append(value)
    return {
        name: {view: np.array(values) for view, values in of_views.items()}
        for name, of_views in series.items()
        if len(of_views) == len(by_view)
    }


def view_pairs(view: ViewFrames) -> Iterator[tuple[Levels, Levels]]:
    """Rendered and true frames in order, one pair in memory."""
    for pair in view.pairs(list(view.frames)):
        check_pair(*pair)
        yield pair


def _masked(view: ViewFrames, mask: MaskReader) -> Iterator[tuple[Levels, ...]]:
    for index, (rendered, truth) in zip(view.frames, view_pairs(view), strict=True):
        yield rendered, truth, mask(index)


def require_changes(views: Views, metric: str) -> None:
    """Refuse views of one frame.

    Args:
        metric: what compares neighbouring frames, as the beginning of a sentence.
    """
    for name, view in views.items():
        if len(view.frames) < 2:
            raise MetricError(f"{metric}: 1 frame of {name}; needs 2")


def crossed(
    measures: Mapping[str, FrameMeasure],
    preparations: Mapping[str, Preparation],
) -> dict[str, FrameMeasure]:
    """Take every measure of frames that are prepared in every way."""
    return {
        ", ".join(filter(None, (name, words))): prepared(measure, prepare)
        for name, measure in measures.items()
        for words, prepare in preparations.items()
    }


def prepared(measure: FrameMeasure, prepare: Preparation) -> FrameMeasure:
    """Return the measure of frames that are prepared first."""
    return lambda *frame: measure(*prepare(*frame))


def remembered(compute: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of two frames with its last result, of which conventions make several."""
    last: dict[Any, Any] = {}

    def again(rendered: Levels, truth: Levels, **options: Any) -> Any:
        key = (id(rendered), id(truth), *options.items())
        if key not in last:
            last.clear()
            last[key] = (
                compute(rendered, truth, **options),
                rendered,
                truth,
            )  # which therefore keep their ids
        return last[key][0]

    return again
