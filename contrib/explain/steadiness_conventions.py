"""Conventions of a quoted mTV or warping error."""

from collections.abc import Iterator
from functools import reduce
from itertools import pairwise

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.explain.conventions import (
    Masks,
    Pooling,
    Recomputed,
    Views,
    conventions,
    over_views,
    require_changes,
    series_of,
    view_pairs,
)
from ggvs_eval.metrics.image.regions import moving_mask
from ggvs_eval.metrics.time.temporal_variation import mtv2
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.pipelines.inspection.renders.steadiness import change_inside

OURS = "where nothing moves between the two frames (Eq. 1)"
ALWAYS = "where no frame moves (one mask, as OR2's)"
EVERYWHERE = "all pixels"
SECOND = "all pixels, second differences"


def _scaled_mean(scale: str, factor: float) -> Pooling:
    return over_views(scale, lambda values: factor * values.mean())


MTV_SCALES = [
    _scaled_mean("x 100", 1.0),
    _scaled_mean("in 0..1", 0.01),
    _scaled_mean("in 0..255", 2.55),
]
WARPING_SCALES = [_scaled_mean("white is 1", 1.0), _scaled_mean("x 1000", 1000.0)]


def mtv_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """Return the change of the renderings from frame to frame in several masks and on several
    scales.
    """
    require_changes(views, "mTV is a change between frames")
    series = series_of({name: _variations(view) for name, view in views.items()})
    return conventions(series, MTV_SCALES, own_name=f"{OURS}, x 100")


def _variations(view: ViewFrames) -> Iterator[dict[str, float | None]]:
    """Each kind of change from a frame to the next; None without pixels."""
    always = ~reduce(
        np.logical_or,
        (moving_mask(after, before) for (_, before), (_, after) in pairwise(view_pairs(view))),
    )
    frames: list[Image8] = []
    for (before, true_before), (after, true_after) in pairwise(view_pairs(view)):
        frames = [*frames[-1:], before]
        yield {
            OURS: change_inside(after, before, ~moving_mask(true_after, true_before)),
            ALWAYS: change_inside(after, before, always),
            EVERYWHERE: change_inside(after, before, None),
            SECOND: mtv2([*frames, after]) if len(frames) > 1 else None,
        }


def warping_conventions(views: Views, _masks: Masks) -> list[Recomputed]:
    """Warping error of the renderings of static cameras, whose geometric flow is zero: against
    which frame, where, how.

    Programs differ by what they square and sum, and by a factor of a thousand; long-term errors
    compare with the first frame.
    """
    require_changes(views, "a warping error is between frames")
    series = series_of({name: _warping_errors(view) for name, view in views.items()})
    return conventions(series, WARPING_SCALES)


def _warping_errors(view: ViewFrames) -> Iterator[dict[str, float]]:
    """Each kind of squared difference of the frames, white is 1; none without pixels."""
    first = next(view_pairs(view))
    for before, (rendered, truth) in pairwise(view_pairs(view)):
        errors = {}
        for words, (reference, true_reference) in {
            "neighbouring frames": before,
            "each frame and the first": first,
        }.items():
            squares = np.square(rendered.astype(np.float64) - reference) / 255.0**2
            static = ~moving_mask(truth, true_reference)
            for where, mask in {OURS: static, EVERYWHERE: np.ones_like(static)}.items():
                if mask.any():
                    error = float(squares[mask].mean())
                    errors[f"{words}, {where}, mean over channels"] = error
                    errors[f"{words}, {where}, sum over channels"] = 3 * error
                    errors[f"{words}, {where}, root of the mean"] = error**0.5
        yield errors
