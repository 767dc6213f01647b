"""A number under one convention, over all views and over each alone."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames

ALL_VIEWS = "all views"
MaskReader = Callable[[int], NDArray[np.bool_]]
FrameMeasure = Callable[[Image8, Image8], float]


@dataclass(frozen=True)
class Recomputed:
    """A convention and its values.

    Attributes:
        values: ``all views`` or the name of a view -> number.
        is_ours: whether it is this tool's convention.
    """

    name: str
    values: Mapping[str, float]
    is_ours: bool = False


def view_pairs(view: ViewFrames) -> Iterator[tuple[Image8, Image8]]:
    """Rendered and true frames in order, one pair in memory."""
    for pair in view.pairs(list(view.frames)):
        check_pair(*pair)
        yield pair


def frame_means(views: Mapping[str, ViewFrames], measures: Mapping[str, FrameMeasure], ours: str) -> list[Recomputed]:
    """Measures of single frames, mean over the frames of a view, then over the views."""
    names = list(measures)
    tables = {view: [[measures[name](*pair) for name in names] for pair in view_pairs(frames)] for view, frames in views.items()}
    return [
        Recomputed(
            name, mean_over_views({view: np.mean([row[i] for row in rows]) for view, rows in tables.items()}), name == ours
        )
        for i, name in enumerate(names)
    ]


def mean_over_views(by_view: Mapping[str, float | np.floating]) -> dict[str, float]:
    """Values of single views, and their mean."""
    return {ALL_VIEWS: float(np.mean(list(by_view.values())))} | {view: float(value) for view, value in by_view.items()}


def changes(view: ViewFrames, between: Callable[[Image8, Image8], Image8]) -> Iterable[tuple[Image8, Image8]]:
    """Yield the change from each frame to the next, rendered and true."""
    before: tuple[Image8, Image8] | None = None
    for rendered, truth in view_pairs(view):
        if before is not None:
            yield between(before[0], rendered), between(before[1], truth)
        before = rendered, truth
