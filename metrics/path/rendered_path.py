"""A rendered camera path, gathered pose by pose, and its metrics' interface."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import read_image, to_8_bit, write_image
from ggvs_eval.metrics.image.sharpness import sharpness
from ggvs_eval.metrics.inputs import Image
from ggvs_eval.metrics.metric import ALONG_PATH, Group, Kind, Metric, Value
from ggvs_eval.metrics.path.steps import DEPTH_TOLERANCE, StepError, reprojection_step


@dataclass(frozen=True, eq=False)
class PathPose:
    """One pose of a rendered camera path.

    Attributes:
        camera: the pose.
        image: rendered image, (H, W, 3), uint8 in 0..255 or float in [0, 1].
        depth: (H, W) float32, world units, 0 = unknown; None without depth.
        sources: names of the cameras that the image is made of, e.g. the K nearest; empty where unknown.
    """

    camera: Camera
    image: Image
    depth: NDArray[np.float32] | None = None
    sources: Collection[str] = ()


@dataclass(frozen=True)
class SlopeOptions:
    """Thresholds above which the images show a slope, and within which it agrees.

    Attributes:
        least_texture_255: least root mean square gradient across a line, grey levels of 255 per pixel.
        least_coherence: least coherence of a line, see `epi_coherence`.
        tolerance_px: slopes that differ by no more agree, px per pose step.
    """

    least_texture_255: float = 4.0
    least_coherence: float = 0.5
    tolerance_px: float = 0.1


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


def write_view(folder: Path, index: int, image: Image) -> None:
    """Write a whole image of a path for the metrics that want files."""
    (folder / "views").mkdir(exist_ok=True)
    write_image(_view_file(folder, index), to_8_bit(image))


def _view_file(folder: Path, index: int) -> Path:
    return folder / "views" / f"{index:06d}.png"


def _depth_file(folder: Path, index: int) -> Path:
    return folder / "views" / f"{index:06d}.npy"


def spread_rows(height: int, count: int) -> list[int]:
    """At most `count` evenly spaced rows of an image, each in the middle of its part."""
    count = min(count, height)
    return [int((index + 0.5) * height / count) for index in range(count)]


class RenderedPath:
    """State of a path so far that the metrics need: chosen image rows, at most two whole poses, and the steps between.

    Attributes:
        rows: image rows that EPIs are taken from.
        depths: those rows of each pose's depth; None without depth.
        sources: names of the source cameras of each pose.
        n_switches: steps at which the source cameras change; None where that was not measured.
        sharpness: of each pose's image, see `metrics.image.sharpness`.
        folder: where the whole images lie, see `write_view`, and the depths; None where no metric wants them.
    """

    def __init__(self, options: PathOptions, folder: Path | None = None) -> None:
        self.options = options
        self.folder = folder
        self.cameras: list[Camera] = []
        self.rows: list[int] = []
        self.depths: list[NDArray[np.float32] | None] = []
        self.sources: list[Collection[str]] = []
        self.n_switches: int | None = None
        self.sharpness: list[float] = []
        self._images: list[Image] = []  # the chosen rows of every pose
        self._steps: list[StepError] = []
        self._no_steps = ""
        self._before: PathPose | None = None

    def add(self, pose: PathPose) -> None:
        """Take the next pose.

        Raises:
            MetricError: an image that does not fit its camera, or another size than before.
        """
        if pose.image.shape != (pose.camera.height, pose.camera.width, 3):
            size = f"{pose.camera.height} x {pose.camera.width} x 3"
            raise MetricError(f"pose {pose.camera.name}: wanted an image {size}, got {pose.image.shape}; resize one of them")
        self.rows = self.rows or spread_rows(pose.camera.height, self.options.n_rows)
        if self.cameras and pose.camera.size != self.cameras[0].size:
            raise MetricError(
                f"pose {pose.camera.name}: {pose.camera.size}, before it {self.cameras[0].size}; a path has one size"
            )
        self.cameras.append(pose.camera)
        self._images.append(pose.image[self.rows])
        self.depths.append(None if pose.depth is None else pose.depth[self.rows])
        self.sources.append(pose.sources)
        self.sharpness.append(sharpness(pose.image))
        if self.folder is not None:
            write_view(self.folder, len(self.cameras) - 1, pose.image)
            if pose.depth is not None:
                np.save(_depth_file(self.folder, len(self.cameras) - 1), pose.depth)
        before, self._before = self._before, pose
        if before is not None and not self._no_steps:
            self._add_step(before, pose)

    @property
    def steps(self) -> list[StepError]:
        """Each pose against the one before it."""
        if self._no_steps:
            raise MetricError(self._no_steps)
        return self._steps

    def epis(self) -> Iterator[Image]:
        """Epipolar plane images, one per chosen row, each (V, W, 3)."""
        return (np.stack([rows[index] for rows in self._images]) for index in range(len(self.rows)))

    def look(self, index: int) -> tuple[Image, NDArray[np.float32] | None]:
        """Whole image and depth of a pose, read from the folder.

        Raises:
            MetricError: they were not kept.
        """
        if self.folder is None:
            raise MetricError("the images of the path were not kept; name the metrics that want them when the path is scored")
        depth = _depth_file(self.folder, index)
        return read_image(_view_file(self.folder, index)), np.load(depth) if depth.is_file() else None

    def _add_step(self, *poses: PathPose) -> None:
        before, after = ((pose.camera, pose.image, pose.depth) for pose in poses)
        try:
            self._steps.append(reprojection_step(before, after, self.options.depth_tolerance))
        except MetricError as error:
            self._no_steps = str(error)


@dataclass(frozen=True)
class PathScorer:
    """Computes one or several metrics of a path at once.

    Attributes:
        names: of its values for the whole path; beside metrics these may be numbers that help to read them.
        measure: the path -> values; raises `MetricError` where there can be none.
        why_absent: the reason for a name that it leaves out.
        wants_images: whether it works on files of the whole images, which takes seconds: measured only where it is named.
    """

    names: tuple[str, ...]
    measure: Callable[[RenderedPath], list[Value]]
    why_absent: str = ""
    wants_images: bool = False


@dataclass(frozen=True, kw_only=True)
class PathMetric(Metric):
    """A metric of images along a camera path, without truth.

    Attributes:
        scorer: computes it; metrics may share one.
    """

    kind: Kind = "path"
    group: Group = ALONG_PATH
    reference: str = "docs/metrics.md"
    scorer: PathScorer

    @property
    def modules(self) -> tuple[str, ...]:
        """See `Metric`."""
        return tuple(sorted({*super().modules, self.scorer.measure.__module__}))


def whole_path(names: tuple[str, ...], *values: float) -> list[Value]:
    """Values of the whole path."""
    return [(name, None, value) for name, value in zip(names, values, strict=True)]
