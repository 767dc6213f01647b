"""Metrics of plug-ins: each is measured in a process of its own, which gets copies of the frames
and gives back numbers.

So it cannot write into what others are measured on, and where it ends its process that costs its
own values alone. A process takes 0.4 s to start, once for all views that a worker measures; a frame
of 1352 x 1014 pixels takes 8 ms to get there.
"""

from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from itertools import count
from math import isnan
from numbers import Real
from operator import index
from pathlib import Path
from typing import Any

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import GgvsError, MetricError
from ggvs_eval.metrics.metric import (
    ColourMap,
    MetricOptions,
    Scorer,
    TableMetric,
    TruthFrame,
    Value,
)
from ggvs_eval.metrics.registry import METRICS, scorer_factory
from ggvs_eval.plugins import foreign
from ggvs_eval.side_process import SideProcess, serve

LONGEST_ANSWER_S = 600.0  # for a frame, or for the last of a view
# by metrics
PROCESSES: dict[str, SideProcess] = defaultdict(partial(SideProcess, Path(__file__), quiet=False))
_SCORERS: dict[int, Scorer] = {}  # in such a process
_NUMBERS = count()  # of scorers


def foreign_values(
    names: Sequence[str], *arguments: Any, scoring: tuple[Any, ...] = ()
) -> list[Any]:
    """Have a plug-in's metric measured in its process.

    Args:
        names: of all metrics that are measured at once.
        arguments: of their function.
        scoring: which scorer is to measure a frame, and which frame; see `_score`.

    Raises:
        MetricError: it failed, ended its process, took over ten minutes, or gave no numbers of its
            own.
    """
    failure = _failure(names)
    with foreign(failure, MetricError):
        values: list[Any] | str = PROCESSES[failure].ask(
            (tuple(METRICS.origins(names)), arguments, scoring), LONGEST_ANSWER_S
        )
    if isinstance(values, str):
        raise MetricError(values)
    return values


class ForeignScorer:
    """A scorer of a plug-in's metrics.

    Where it ends its process, the values of all renderings that it was measuring are lost, and
    where it looks at single frames alone those of one rendering.
    """

    def __init__(
        self, names: Sequence[str], options: MetricOptions, colour_map: ColourMap | None
    ) -> None:
        self.names = names
        self._scoring = next(_NUMBERS), options, colour_map
        self._n_frames = 0

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        self._n_frames = index + 1
        return self._measured(rendered, truth.image, truth.previous, truth.disoccluded)

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return self._measured()

    def _measured(self, *frame: Any) -> list[Value]:
        return foreign_values(self.names, *frame, scoring=(*self._scoring, self._n_frames))


def _failure(names: Sequence[str]) -> str:
    return ", ".join(
        f"{origin}: metric {name} failed" for name, origin in METRICS.origins(names).items()
    )


def _measure(request: tuple[Sequence[str], Sequence[Any], tuple[Any, ...]]) -> list[Any] | str:
    """Return the values that are asked for, or the reason why there are none."""
    names, arguments, scoring = request
    try:
        with foreign(_failure(names), MetricError):
            metric: Any = METRICS[names[0]]
            if scoring:
                values = _score(metric, names, *scoring, *arguments)
            elif isinstance(metric, TableMetric):
                values = metric.rows(*arguments)
            else:
                values = metric.scorer.measure(*arguments)
            return [_checked(*value) for value in values]
    except GgvsError as error:
        return str(error)


def _checked(
    place: str | None, frame: int | None, value: Any
) -> tuple[str | None, int | None, float]:
    if place in METRICS.shipped:
        raise ValueError(f"wanted values of its own, got one of {place}")
    if not isinstance(value, Real):
        raise TypeError(f"wanted a number, got {type(value).__name__}")
    if isnan(value):
        raise ValueError("wanted a number, got nan")
    return place, None if frame is None else index(frame), float(value)


def _score(
    metric: Any,
    names: Sequence[str],
    number: int,
    options: MetricOptions,
    colour_map: ColourMap | None,
    n_frames: int,
    *frame: Any,
) -> list[Any]:
    """Add the last of these frames to the scorer of a number, or finish where there is none."""
    scorer = _SCORERS.pop(number, None)
    if scorer is None:
        if metric.scorer and n_frames > 1:
            raise ChildProcessError("its process ended while it measured something else")
        scorer = scorer_factory(metric)(names, options, colour_map)
    if frame:
        rendered, *truth = frame
        values = scorer.add(n_frames - 1, rendered, TruthFrame(*truth))
        _SCORERS[number] = scorer
    else:
        values = scorer.finish()
    return [
        (name, None if at is None else range(n_frames)[at], value) for name, at, value in values
    ]


if __name__ == "__main__":
    serve(_measure, _SCORERS, prints=True)
