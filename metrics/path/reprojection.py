"""Reprojection error of a camera path: the mean over its steps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathScorer, RenderedPath, whole_path
from ggvs_eval.metrics.path.steps import StepError, reprojection_steps
from ggvs_eval.metrics.path.warping_error import PATH_SHARPNESS

NAMES = ("reprojection", "reprojection_visible", "reprojection_shift")


@dataclass(frozen=True)
class Reprojection:
    """Mean over the steps of a path.

    Attributes:
        error_255: mean absolute colour difference over co-visible pixels, grey levels of 255, mean over the steps that have any;
            lower is better.
        visible_share: co-visible pixels of all pixels, mean over all steps; an error over few of them says little.
        shift_px: the error as the shift along the rows that would change the images as much, pixels. Blur lowers the error and
            the texture alike, and this hardly.
    """

    error_255: float
    visible_share: float
    shift_px: float


def mean_reprojection(steps: Sequence[StepError]) -> Reprojection:
    """Mean over the steps of a path, each with equal weight.

    Raises:
        MetricError: no step whose poses see a surface in common, or images without any texture, whose error no shift explains.
    """
    measured = [(step.error_255, step.texture_255) for step in steps if step.error_255 is not None]
    if not measured:
        raise MetricError(f"reprojection: at none of {len(steps)} steps do the poses see a surface in common; check the depths")
    error_255, texture_255 = np.array(measured, dtype=np.float64).mean(axis=0).tolist()
    if not texture_255:
        raise MetricError("reprojection: images without texture look the same from everywhere; nothing to compare")
    return Reprojection(error_255, float(np.mean([step.visible_share for step in steps])), error_255 / texture_255)


def _measure(path: RenderedPath) -> list[Value]:
    """Error and visible share of every step, at its first pose, and of the whole path."""
    mean = mean_reprojection(path.steps)
    per_step = list(enumerate(path.steps))
    return [
        *(("reprojection", pose, step.error_255) for pose, step in per_step if step.error_255 is not None),
        *(("reprojection_visible", pose, step.visible_share) for pose, step in per_step),
        *whole_path(NAMES, mean.error_255, mean.visible_share, mean.shift_px),
    ]


_SCORER = PathScorer(NAMES, _measure)
REPROJECTION = PathMetric(
    name="reprojection",
    function=reprojection_steps,
    unit="grey levels of 255",
    higher_is_better=False,
    describe="colour change of points seen from two neighbouring poses",
    scorer=_SCORER,
    beside=PATH_SHARPNESS.name,
)
REPROJECTION_VISIBLE = PathMetric(
    name="reprojection_visible",
    function=reprojection_steps,
    higher_is_better=True,
    describe="share of pixels that two neighbouring poses both see",
    scorer=_SCORER,
)
