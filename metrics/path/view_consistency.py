"""View consistency of a camera path: reprojection and warping errors over its steps, and jumps
where other sources take over.

The geometric warping error has the form in which papers print it, and the sharpness to read it
with. Jumps of the picture are the abrupt changes that the paper's EPI figure points at.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.sharpness import SHARPNESS, sharpness
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.rendered_path import (
    DEPTH_TOLERANCE,
    PathMetric,
    PathScorer,
    Pose,
    RenderedPath,
    StepError,
    reprojection_steps,
    whole_path,
)

REPROJECTION_NAMES = ("reprojection", "reprojection_visible", "reprojection_shift")
PER_MILLE = 1000.0
SWITCH_NAMES = ("switch_ratio", "switch_excess")
# mean absolute difference of two images that differ by rounding to 8 bit alone
ROUNDING_255 = 1.0 / 3.0


def warping_error(poses: Iterable[Pose], depth_tolerance: float = DEPTH_TOLERANCE) -> float:
    """Return the warping error E_warp (Lai et al., ECCV 2018) of images along a camera path, the
    flow taken from depth and poses.

    Args:
        poses: camera, image (H, W, 3) uint8 in 0..255 or float in [0, 1], and depth (H, W) float32,
            world units, 0 = unknown; in order; consumed as a stream, two poses in memory. Where the
            scene itself moves, set the depth to 0: it has no vote.
        depth_tolerance: see `reprojection_step`.

    Returns:
        Mean over the steps of the mean squared colour difference over co-visible pixels and
        channels, white is 1, times 1000. 0 for images that agree, and nearly so for blurred ones:
        read it with `sharpness`.

    Raises:
        MetricError: fewer than two poses, no surface in common at any step, or what
            `reprojection_step` refuses.

    Example:
        >>> import numpy as np
        >>> from ggvs_eval.camera import Camera
        >>> camera = Camera(
        ...     "path0000", np.diag([50.0, 50.0, 1.0]), np.eye(4), 64, 48, near=1.0, far=9.0
        ... )
        >>> wall = np.full((48, 64), 4.0, np.float32)
        >>> poses = [(camera, np.full((48, 64, 3), level, np.uint8), wall) for level in (100, 125)]
        >>> round(warping_error(poses), 2)  # a flash of 25 / 255, squared
        9.61

    Reading:
        The definition squares a vector of colour, its authors' program takes the mean over
        channels; so does this. Their flow is estimated from the video, so that a video may bend it
        to its own errors; depth that is one for all methods cannot be. Each step compares at the
        later pose, and visibility is a weight, not a mask.
    """
    return _mean_error(reprojection_steps(poses, depth_tolerance))


def _mean_error(steps: Iterable[StepError]) -> float:
    errors = [step.squared_error for step in steps if step.squared_error is not None]
    if not errors:
        raise MetricError(
            "E_warp: at no step do the poses see a surface in common; check the depths"
        )
    return PER_MILLE * float(np.mean(errors))


PATH_SHARPNESS = PathMetric(
    name="path_sharpness",
    function=sharpness,
    unit=SHARPNESS.unit,
    higher_is_better=True,
    decimals=3,
    describe="mean absolute difference of neighbouring pixels along the path; higher consistency "
    "with lower sharpness is blur",
    reference="docs/metrics.md",
    scorer=PathScorer(
        ("path_sharpness",),
        lambda path: whole_path(("path_sharpness",), float(np.mean(path.sharpness))),
    ),
)


def _measure_warping(path: RenderedPath) -> list[Value]:
    return whole_path(("E_warp",), _mean_error(path.steps))


E_WARP = PathMetric(
    name="E_warp",
    function=warping_error,
    unit="10⁻³",
    higher_is_better=False,
    describe="mean squared colour change of points seen from two neighbouring poses, by depth; "
    "blur lowers it",
    reference="Lai et al., ECCV 2018",
    scorer=PathScorer(("E_warp",), _measure_warping),
    beside=PATH_SHARPNESS.name,
)


@dataclass(frozen=True)
class Reprojection:
    """Mean over the steps of a path.

    Attributes:
        error_255: mean absolute colour difference over co-visible pixels, grey levels of 255, mean
            over the steps that have any; lower is better.
        visible_share: co-visible pixels of all pixels, mean over all steps; an error over few of
            them says little.
        shift_px: the error as the shift along the rows that would change the images as much,
            pixels. Blur lowers the error and the texture alike, and this hardly.
    """

    error_255: float
    visible_share: float
    shift_px: float


def mean_reprojection(steps: Sequence[StepError]) -> Reprojection:
    """Return the mean over the steps of a path, each with equal weight.

    Raises:
        MetricError: no step whose poses see a surface in common, or images without any texture,
            whose error no shift explains.
    """
    errors = [(step.error_255, step.texture_255) for step in steps if step.error_255 is not None]
    if not errors:
        raise MetricError(
            f"reprojection: at none of {len(steps)} steps do the poses see a surface in common; "
            f"check the depths"
        )
    error_255, texture_255 = np.array(errors, dtype=np.float64).mean(axis=0).tolist()
    if not texture_255:
        raise MetricError("reprojection: wanted images with texture, got none; nothing to compare")
    return Reprojection(
        error_255, float(np.mean([step.visible_share for step in steps])), error_255 / texture_255
    )


def _measure_reprojection(path: RenderedPath) -> list[Value]:
    """Return the error and visible share of every step, at its first pose, and of the whole
    path.
    """
    mean = mean_reprojection(path.steps)
    per_step = list(enumerate(path.steps))
    return [
        *(
            ("reprojection", pose, step.error_255)
            for pose, step in per_step
            if step.error_255 is not None
        ),
        *(("reprojection_visible", pose, step.visible_share) for pose, step in per_step),
        *whole_path(REPROJECTION_NAMES, mean.error_255, mean.visible_share, mean.shift_px),
    ]


_REPROJECTION_SCORER = PathScorer(REPROJECTION_NAMES, _measure_reprojection)
REPROJECTION = PathMetric(
    name="reprojection",
    function=reprojection_steps,
    unit="grey levels of 255",
    higher_is_better=False,
    describe="colour change of points seen from two neighbouring poses",
    scorer=_REPROJECTION_SCORER,
    beside=PATH_SHARPNESS.name,
)
REPROJECTION_VISIBLE = PathMetric(
    name="reprojection_visible",
    function=reprojection_steps,
    higher_is_better=True,
    describe="share of pixels that two neighbouring poses both see",
    scorer=_REPROJECTION_SCORER,
)


@dataclass(frozen=True)
class SwitchScore:
    """Change at the steps where the set of source cameras changes, against the other steps.

    Attributes:
        ratio: mean change at the switches over the mean elsewhere; 1 = no more than elsewhere,
            lower is better.
        excess_255: mean change at the switches less the mean elsewhere, grey levels of 255; 0 = no
            more than elsewhere.
        n_switches: measured steps at which the set changes.
    """

    ratio: float
    excess_255: float
    n_switches: int
    n_steps: int


def switch_steps(sources: Sequence[Collection[str]]) -> list[bool]:
    """Return for each step between poses whether the set of source cameras changes, in any
    order.
    """
    sets = [frozenset(names) for names in sources]
    return [before != after for before, after in pairwise(sets)]


def switch_score(
    step_errors_255: Sequence[float | None], sources: Sequence[Collection[str]]
) -> SwitchScore:
    """Compare the change along the path at switches of the source cameras with the change
    elsewhere.

    Args:
        step_errors_255: change from each pose to the next after motion compensation by depth, grey
            levels of 255, V - 1 of them: `StepError.error_255`; steps that have none (None) do not
            count.
        sources: names of the source cameras of each pose, V of them, e.g. the K nearest.

    Raises:
        MetricError: numbers that do not fit each other, no switch on this path, or a switch at
            every step.

    Reading:
        Not in the paper. Parallax does not count, since the change is taken along the lines of the
        EPI. 8-bit rounding alone changes 1/3 grey level; means below that count as 1/3 in the
        ratio, so that it stays finite for perfect renderings.
    """
    if len(sources) != len(step_errors_255) + 1:
        raise MetricError(
            f"switch score: {len(sources)} poses have {len(sources) - 1} steps, got "
            f"{len(step_errors_255)} errors"
        )
    switches = switch_steps(sources)
    if not any(switches):
        raise MetricError(
            f"no switch on this path: one set of source cameras at all {len(sources)} poses; use a "
            f"longer path"
        )
    if all(switches):
        raise MetricError(
            f"every step switches the source cameras ({len(switches)} steps); use more poses on "
            f"this path"
        )
    pairs = [
        (error, switch)
        for error, switch in zip(step_errors_255, switches, strict=True)
        if error is not None
    ]
    at_switches = [error for error, switch in pairs if switch]
    elsewhere = [error for error, switch in pairs if not switch]
    if not at_switches or not elsewhere:
        raise MetricError(
            f"no step {'with' if elsewhere else 'without'} a switch could be measured; check the "
            f"depths"
        )
    switch_error, other_error = float(np.mean(at_switches)), float(np.mean(elsewhere))
    return SwitchScore(
        ratio=max(switch_error, ROUNDING_255) / max(other_error, ROUNDING_255),
        excess_255=switch_error - other_error,
        n_switches=len(at_switches),
        n_steps=len(pairs),
    )


def _measure_switches(path: RenderedPath) -> list[Value]:
    if not any(path.sources):
        raise MetricError(
            "switch score: wanted the source cameras of each pose, got none; name them"
        )
    score = switch_score([step.error_255 for step in path.steps], path.sources)
    path.n_switches = score.n_switches
    return whole_path(SWITCH_NAMES, score.ratio, score.excess_255)


_SWITCH_SCORER = PathScorer(SWITCH_NAMES, _measure_switches)
SWITCH_RATIO = PathMetric(
    name="switch_ratio",
    function=switch_score,
    higher_is_better=False,
    describe="change at switches of source cameras, relative to change elsewhere",
    scorer=_SWITCH_SCORER,
)
SWITCH_EXCESS = PathMetric(
    name="switch_excess",
    function=switch_score,
    unit="grey levels of 255",
    higher_is_better=False,
    describe="change at switches of source cameras, minus change elsewhere",
    scorer=_SWITCH_SCORER,
)
