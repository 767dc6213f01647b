"""Geometric warping error of a camera path, in the form in which papers print it, and the sharpness to read it with."""

from collections.abc import Iterable

import numpy as np

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.sharpness import SHARPNESS, sharpness
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathScorer, RenderedPath, whole_path
from ggvs_eval.metrics.path.steps import DEPTH_TOLERANCE, Pose, StepError, reprojection_steps

PER_MILLE = 1000.0


def warping_error(poses: Iterable[Pose], depth_tolerance: float = DEPTH_TOLERANCE) -> float:
    """Warping error E_warp (Lai et al., ECCV 2018) of images along a camera path, the flow taken from depth and poses.

    Args:
        poses: camera, image (H, W, 3) uint8 in 0..255 or float in [0, 1], and depth (H, W) float32, world units, 0 = unknown; in
            order; consumed as a stream, two poses in memory. Where the scene itself moves, set the depth to 0: it has no vote.
        depth_tolerance: see `steps.reprojection_step`.

    Returns:
        Mean over the steps of the mean squared colour difference over co-visible pixels and channels, white is 1, times 1000. 0
        for images that agree, and nearly so for blurred ones: read it beside `sharpness`.

    Raises:
        MetricError: fewer than two poses, no surface in common at any step, or what `steps.reprojection_step` refuses.

    Example:
        >>> import numpy as np
        >>> from ggvs_eval.camera import Camera
        >>> camera = Camera("path0000", np.diag([50.0, 50.0, 1.0]), np.eye(4), 64, 48, near=1.0, far=9.0)
        >>> wall = np.full((48, 64), 4.0, np.float32)
        >>> poses = [(camera, np.full((48, 64, 3), level, np.uint8), wall) for level in (100, 125)]
        >>> round(warping_error(poses), 2)  # a flash of 25 / 255, squared
        9.61

    Reading:
        The definition squares a vector of colour, its authors' program takes the mean over channels; so does this. Their flow is
        estimated from the video, so that a video may bend it to its own errors; depth that is one for all methods cannot be.
        Each step compares at the later pose, and visibility is a weight, not a mask.
    """
    return _mean_error(reprojection_steps(poses, depth_tolerance))


def _mean_error(steps: Iterable[StepError]) -> float:
    errors = [step.squared_error for step in steps if step.squared_error is not None]
    if not errors:
        raise MetricError("E_warp: at no step do the poses see a surface in common; check the depths")
    return PER_MILLE * float(np.mean(errors))


PATH_SHARPNESS = PathMetric(
    name="path_sharpness",
    function=sharpness,
    unit=SHARPNESS.unit,
    higher_is_better=True,
    decimals=3,
    describe="mean absolute difference of neighbouring pixels along the path; a consistency beside a lower one is blur",
    reference="docs/metrics.md",
    scorer=PathScorer(("path_sharpness",), lambda path: whole_path(("path_sharpness",), float(np.mean(path.sharpness)))),
)


def _measure(path: RenderedPath) -> list[Value]:
    return whole_path(("E_warp",), _mean_error(path.steps))


E_WARP = PathMetric(
    name="E_warp",
    function=warping_error,
    unit="10⁻³",
    higher_is_better=False,
    describe="mean squared colour change of points seen from two neighbouring poses, by depth; blur lowers it",
    reference="Lai et al., ECCV 2018",
    scorer=PathScorer(("E_warp",), _measure),
    beside=PATH_SHARPNESS.name,
)
