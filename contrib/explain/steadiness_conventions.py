"""Conventions of a quoted mTV or warping error."""

from collections import deque
from collections.abc import Mapping
from functools import reduce
from itertools import pairwise

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.explain.frame_conventions import MaskReader, Recomputed, mean_over_views, view_pairs
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.regions import moving_mask
from ggvs_eval.metrics.time.temporal_variation import mtv2
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.pipelines.inspection.renders.steadiness import change_inside

OURS = "where nothing moves between the two frames (Eq. 1)"
ALWAYS = "where no frame moves (one mask, as OR2's)"
EVERYWHERE = "all pixels"
SECOND = "all pixels, second differences"
SCALES = {"x 100": 1.0, "in 0..1": 0.01, "in 0..255": 2.55}


def mtv_conventions(views: Mapping[str, ViewFrames], _masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Return the change of the renderings from frame to frame in several masks and on several scales."""
    by_view = {name: _variations(name, view) for name, view in views.items()}
    measured = [kind for kind in (OURS, ALWAYS, EVERYWHERE, SECOND) if all(kind in values for values in by_view.values())]
    return [
        Recomputed(
            f"{kind}, {scale}",
            mean_over_views({view: factor * values[kind] for view, values in by_view.items()}),
            kind == OURS and scale == "x 100",
        )
        for kind in measured
        for scale, factor in SCALES.items()
    ]


def _variations(name: str, view: ViewFrames) -> dict[str, float]:
    """Return the mean of each kind over the frames of a view; a kind without pixels is left out."""
    if len(view.frames) < 2:
        raise MetricError(f"mTV is a change between frames: 1 frame of {name}; needs 2")
    always = ~reduce(np.logical_or, (moving_mask(after, before) for (_, before), (_, after) in pairwise(view_pairs(view))))
    values: dict[str, list[float]] = {}
    window: deque[tuple[Image8, Image8]] = deque(maxlen=3)
    for pair in view_pairs(view):
        window.append(pair)
        if len(window) == 3:
            values.setdefault(SECOND, []).append(mtv2([rendered for rendered, _ in window]))
        if len(window) > 1:
            (before, true_before), (after, true_after) = list(window)[-2:]
            for kind, mask in ((OURS, ~moving_mask(true_after, true_before)), (ALWAYS, always), (EVERYWHERE, None)):
                if (value := change_inside(after, before, mask)) is not None:
                    values.setdefault(kind, []).append(value)
    return {kind: float(np.mean(each)) for kind, each in values.items()}


def warping_conventions(views: Mapping[str, ViewFrames], _masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Warping error of the renderings of static cameras, whose geometric flow is zero: against which frame, where, how.

    Programs differ by what they square and sum, and by a factor of a thousand; long-term errors compare with the first frame.
    """
    by_view = {name: _warping_errors(name, view) for name, view in views.items()}
    measured = [kind for kind in next(iter(by_view.values())) if all(kind in values for values in by_view.values())]
    return [
        Recomputed(f"{kind}, {scale}", mean_over_views({view: factor * values[kind] for view, values in by_view.items()}))
        for kind in measured
        for scale, factor in {"white is 1": 1.0, "x 1000": 1000.0}.items()
    ]


def _warping_errors(name: str, view: ViewFrames) -> dict[str, float]:
    """Return the mean over the frames of each kind of squared difference, white is 1."""
    if len(view.frames) < 2:
        raise MetricError(f"a warping error is between frames: 1 frame of {name}; needs 2")
    values: dict[str, list[float]] = {}
    first: tuple[Image8, Image8] | None = None
    before: tuple[Image8, Image8] | None = None
    for rendered, truth in view_pairs(view):
        for words, other in (("neighbouring frames", before), ("each frame and the first", first)):
            if other is None:
                continue
            squares = np.square(rendered.astype(np.float64) - other[0]) / 255.0**2
            for where, mask in ((OURS, ~moving_mask(truth, other[1])), (EVERYWHERE, np.ones(truth.shape[:2], bool))):
                if mask.any():
                    error = float(squares[mask].mean())
                    for how, value in (
                        ("mean over channels", error),
                        ("sum over channels", 3 * error),
                        ("root of the mean", error**0.5),
                    ):
                        values.setdefault(f"{words}, {where}, {how}", []).append(value)
        before = rendered, truth
        first = first or before
    return {kind: float(np.mean(each)) for kind, each in values.items()}
