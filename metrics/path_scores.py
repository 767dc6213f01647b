"""All measures of a rendered camera path in one pass; the path needs no truth."""

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image
from ggvs_eval.metrics.path.epi_coherence import epi_coherence
from ggvs_eval.metrics.path.epi_slope import SlopeOptions, slope_agreement
from ggvs_eval.metrics.path.horizontal_path import horizontal_path
from ggvs_eval.metrics.path.reprojection import DEPTH_TOLERANCE, StepError, mean_reprojection, reprojection_step
from ggvs_eval.metrics.path.view_switch import switch_score

COHERENCE = ("EPI_coherence", "EPI_line_texture")
SLOPE = ("EPI_slope_error", "EPI_slope_agreeing", "EPI_slope_measured")
REPROJECTION = ("reprojection", "reprojection_visible", "reprojection_shift")
SWITCH = ("switch_ratio", "switch_excess")
Value = tuple[str, int | None, float]  # measure, pose (None: the whole path), value


@dataclass(frozen=True, eq=False)
class PathPose:
    """One pose of a rendered camera path.

    Attributes:
        camera: the pose.
        image: rendered image, (H, W, 3), uint8 in 0..255 or float in [0, 1].
        depth: (H, W) float32, world units, 0 = unknown; None where nobody knows.
        sources: names of the cameras that the image is made of, e.g. the K nearest; empty where nobody knows.
    """

    camera: Camera
    image: Image
    depth: NDArray[np.float32] | None = None
    sources: Collection[str] = ()


@dataclass(frozen=True)
class PathOptions:
    """Variants of the measures.

    Attributes:
        n_rows: rows of the image that EPIs are taken from, evenly spaced; all of them in a lower image.
        slope: thresholds of the slope agreement.
        depth_tolerance: of the visibility test, see `reprojection_step`.
    """

    n_rows: int = 128
    slope: SlopeOptions = field(default_factory=SlopeOptions)
    depth_tolerance: float = DEPTH_TOLERANCE


@dataclass(frozen=True)
class PathScores:
    """What could be measured on a path, and why the rest could not.

    Attributes:
        values: (measure, pose, value). The whole path has pose None; ``reprojection`` and ``reprojection_visible`` come for
            every step too, at its first pose, counted from 0.
        not_computed: measure -> reason.
        rows: image rows that EPIs were taken from.
        n_switches: steps at which the source cameras change; None where the switch score was not computed.
    """

    values: list[Value]
    not_computed: dict[str, str]
    rows: tuple[int, ...]
    n_switches: int | None


def score_path(poses: Iterable[PathPose], options: PathOptions | None = None) -> PathScores:
    """Measure the view consistency of images along a camera path.

    Args:
        poses: in order; consumed as a stream. Two poses and `n_rows` rows of each are in memory.
        options: variants; the defaults where None.

    Returns:
        Coherence and slope agreement of the EPIs, reprojection error and switch score. A measure that the path cannot have (no
        depth, no switch, not horizontal) is in `not_computed` with its reason, never NaN.

    Raises:
        MetricError: no poses, or images that do not fit their cameras.
    """
    options = options or PathOptions()
    path = _Gathered(options)
    for pose in poses:
        path.add(pose)
    if not path.cameras:
        raise MetricError("no poses to score; render the camera path first")
    values: list[Value] = []
    parts: dict[tuple[str, ...], Callable[[], list[Value]]] = {
        COHERENCE: path.coherence,
        SLOPE: path.slope,
        REPROJECTION: path.reprojection,
        SWITCH: path.switch,
    }
    for names, measure in parts.items():
        try:
            values.extend(measure())
        except MetricError as error:
            path.not_computed.update(dict.fromkeys(names, str(error)))
    return PathScores(values, path.not_computed, tuple(path.rows), path.n_switches)


def spread_rows(height: int, count: int) -> list[int]:
    """At most `count` evenly spaced rows of an image, each in the middle of its part."""
    count = min(count, height)
    return [int((index + 0.5) * height / count) for index in range(count)]


class _Gathered:
    """What the measures need of the poses so far."""

    def __init__(self, options: PathOptions) -> None:
        self._options = options
        self.cameras: list[Camera] = []
        self.rows: list[int] = []
        self.n_switches: int | None = None
        self.not_computed: dict[str, str] = {}
        self._images: list[Image] = []  # the chosen rows of every pose
        self._depths: list[NDArray[np.float32] | None] = []
        self._sources: list[Collection[str]] = []
        self._steps: list[StepError] = []
        self._no_steps = ""
        self._before: PathPose | None = None

    def add(self, pose: PathPose) -> None:
        if pose.image.shape != (pose.camera.height, pose.camera.width, 3):
            wanted = f"{pose.camera.height} x {pose.camera.width} x 3"
            raise MetricError(f"pose {pose.camera.name}: wanted an image {wanted}, got {pose.image.shape}; resize one of them")
        self.rows = self.rows or spread_rows(pose.camera.height, self._options.n_rows)
        if self.cameras and pose.camera.size != self.cameras[0].size:
            raise MetricError(
                f"pose {pose.camera.name}: {pose.camera.size}, before it {self.cameras[0].size}; a path has one size"
            )
        self.cameras.append(pose.camera)
        self._images.append(pose.image[self.rows])
        self._depths.append(None if pose.depth is None else pose.depth[self.rows])
        self._sources.append(pose.sources)
        before, self._before = self._before, pose
        if before is not None and not self._no_steps:
            self._add_step(before, pose)

    def _add_step(self, *poses: PathPose) -> None:
        before, after = ((pose.camera, pose.image, pose.depth) for pose in poses)
        try:
            self._steps.append(reprojection_step(before, after, self._options.depth_tolerance))
        except MetricError as error:
            self._no_steps = str(error)

    def coherence(self) -> list[Value]:
        measured = epi_coherence(self._epis(), horizontal_path(self.cameras))
        return _whole_path(COHERENCE, measured.coherence, measured.line_texture_255)

    def slope(self) -> list[Value]:
        depths = [depth for depth in self._depths if depth is not None]
        if len(depths) < len(self.cameras):
            raise MetricError(f"EPI slope: {len(depths)} of {len(self.cameras)} poses have a depth; give all of them one")
        pairs = ((epi, np.stack([depth[row] for depth in depths])) for row, epi in enumerate(self._epis()))
        measured = slope_agreement(pairs, horizontal_path(self.cameras), self._options.slope)
        shares = _whole_path(SLOPE[1:], measured.agreeing_share, measured.measured_share)
        if measured.median_error_px is None:
            self.not_computed[SLOPE[0]] = "EPI slope: no pixel has texture and a coherent line; no slope to compare with depth's"
            return shares
        return [*_whole_path(SLOPE[:1], measured.median_error_px), *shares]

    def reprojection(self) -> list[Value]:
        mean = mean_reprojection(self._all_steps())
        per_step = list(enumerate(self._steps))
        return [
            *(("reprojection", pose, step.error_255) for pose, step in per_step if step.error_255 is not None),
            *(("reprojection_visible", pose, step.visible_share) for pose, step in per_step),
            *_whole_path(REPROJECTION, mean.error_255, mean.visible_share, mean.shift_px),
        ]

    def switch(self) -> list[Value]:
        if not any(self._sources):
            raise MetricError("switch score: nobody says which cameras the images are made of; name the sources of each pose")
        measured = switch_score([step.error_255 for step in self._all_steps()], self._sources)
        self.n_switches = measured.n_switches
        return _whole_path(SWITCH, measured.ratio, measured.excess_255)

    def _all_steps(self) -> list[StepError]:
        if self._no_steps:
            raise MetricError(self._no_steps)
        return self._steps

    def _epis(self) -> Iterator[Image]:
        return (np.stack([rows[index] for rows in self._images]) for index in range(len(self.rows)))


def _whole_path(names: tuple[str, ...], *values: float) -> list[Value]:
    return [(name, None, value) for name, value in zip(names, values, strict=True)]
