"""A rendered camera path, gathered pose by pose, and its metrics' interface.

Each pose is compared with the one before, reprojected by depth.
"""

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import read_image, to_8_bit, write_image
from ggvs_eval.geometry.warp import warp
from ggvs_eval.metrics.image.sharpness import sharpness
from ggvs_eval.metrics.inputs import Image, check_pair, white_level
from ggvs_eval.metrics.metric import ALONG_PATH, Group, Kind, Metric, Value

DEPTH_TOLERANCE = 0.02
N_ROWS = 128  # of the image that EPIs are taken from, evenly spaced; all of them in a lower image
# the mean over channels, as a product: numpy's own is ten times slower
OVER_RGB = np.full(3, 1 / 3, np.float32)
Pose = tuple[Camera, Image, NDArray[np.float32] | None]


@dataclass(frozen=True)
class StepError:
    """Difference between a pose and the pose before it, carried over by depth.

    Attributes:
        error_255: mean absolute colour difference over co-visible pixels and channels, grey levels
            of 255; None where by their depths the two poses see no surface in common.
        visible_share: co-visible pixels of all pixels.
        texture_255: mean absolute horizontal difference of neighbouring pixels there, grey levels
            of 255; None like the error.
        squared_error: mean squared colour difference there, white is 1; None like the error.
    """

    error_255: float | None
    visible_share: float
    texture_255: float | None
    squared_error: float | None


def reprojection_steps(
    poses: Iterable[Pose], depth_tolerance: float = DEPTH_TOLERANCE
) -> list[StepError]:
    """Reprojection error of every step along a path.

    Args:
        poses: camera, image (H, W, 3) uint8 in 0..255 or float in [0, 1], and depth (H, W) float32,
            world units, 0 = unknown; in order, any kind of path; consumed as a stream, two poses in
            memory.
        depth_tolerance: see `reprojection_step`.

    Returns:
        One error per step, V - 1 of them.
    """
    steps = [reprojection_step(before, after, depth_tolerance) for before, after in pairwise(poses)]
    if not steps:
        raise MetricError(
            "reprojection compares neighbouring poses: wanted at least 2 poses on the path; add "
            "poses"
        )
    return steps


def reprojection_step(
    before: Pose, after: Pose, depth_tolerance: float = DEPTH_TOLERANCE
) -> StepError:
    """Carry a pose's image to the next pose and compare the two there.

    Args:
        depth_tolerance: the poses see one surface where their depths differ by less than this share
            of the median depth; visibility falls to 0 at twice this.

    Reading:
        Not in the paper. Colours are sampled with Catmull-Rom splines, so that interpolation hardly
        blurs. Visibility weights the mean. Depths that contradict each other make pixels invisible,
        not wrong: they lower `visible_share`.
    """
    cameras = before[0], after[0]
    depths = [checked_depth(camera, depth) for camera, _, depth in (before, after)]
    images = [_checked_image(camera, image) for camera, image, _ in (before, after)]
    check_pair(before[1], after[1])
    valid_depths = depths[1][depths[1] > 0]
    if not valid_depths.size:
        return StepError(error_255=None, visible_share=0.0, texture_255=None, squared_error=None)
    tolerance = depth_tolerance * float(np.median(valid_depths))
    carried = warp(cameras[1], depths[1], cameras[0], images[0], depths[0], tolerance, bicubic=True)
    weight = float(carried.visibility.sum(dtype=np.float64))
    if not weight:
        return StepError(error_255=None, visible_share=0.0, texture_255=None, squared_error=None)
    difference = carried.colour - images[1]
    texture = np.abs(np.diff(images[1], axis=1)) @ OVER_RGB
    error, squared, texture_there = (
        float((carried.visibility[:, -error_map.shape[1] :] * error_map).sum(dtype=np.float64))
        / weight
        for error_map in (np.abs(difference) @ OVER_RGB, np.square(difference) @ OVER_RGB, texture)
    )
    return StepError(
        error_255=255 * error,
        visible_share=weight / carried.visibility.size,
        texture_255=255 * texture_there,
        squared_error=squared,
    )


def _checked_image(camera: Camera, image: Image) -> NDArray[np.float32]:
    """Return the image as float32 in [0, 1]."""
    if image.shape != (camera.height, camera.width, 3):
        raise MetricError(
            f"pose {camera.name}: wanted an image {camera.height} x {camera.width} x 3, got "
            f"{image.shape}"
        )
    return image.astype(np.float32) / np.float32(white_level(image))


def checked_depth(camera: Camera, depth: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """Return the depth of a pose if it has one that fits its camera."""
    if depth is None:
        raise MetricError(f"pose {camera.name}: no depth; wanted depth along the path")
    if (
        depth.shape != (camera.height, camera.width)
        or not np.isfinite(depth).all()
        or (depth < 0).any()
    ):
        raise MetricError(
            f"pose {camera.name}: wanted depths >= 0 of {camera.height} x {camera.width}, 0 = "
            f"unknown, got {depth.shape} with "
            f"{np.count_nonzero(~(np.isfinite(depth) & (depth >= 0)))} bad values"
        )
    return depth


@dataclass(frozen=True, eq=False)
class PathPose:
    """One pose of a rendered camera path.

    Attributes:
        camera: the pose.
        image: rendered image, (H, W, 3), uint8 in 0..255 or float in [0, 1].
        depth: (H, W) float32, world units, 0 = unknown; None without depth.
        sources: names of the cameras that the image is made of, e.g. the K nearest; empty if
            unknown.
    """

    camera: Camera
    image: Image
    depth: NDArray[np.float32] | None = None
    sources: Collection[str] = ()


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
    """State of a path so far that the metrics need: chosen image rows, at most two whole poses, and
    the steps between.

    Attributes:
        rows: image rows that EPIs are taken from.
        depths: those rows of each pose's depth; None without depth.
        sources: names of the source cameras of each pose.
        n_switches: steps at which the source cameras change; None if that was not measured.
        sharpness: of each pose's image, see `metrics.image.sharpness`.
        folder: of the complete images, see `write_view`, and the depths; None if no metric wants
            them.
    """

    def __init__(self, folder: Path | None = None) -> None:
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
            raise MetricError(
                f"pose {pose.camera.name}: wanted an image {size}, got {pose.image.shape}; resize "
                f"one of them"
            )
        self.rows = self.rows or spread_rows(pose.camera.height, N_ROWS)
        if self.cameras and pose.camera.size != self.cameras[0].size:
            raise MetricError(
                f"pose {pose.camera.name}: {pose.camera.size}, before it {self.cameras[0].size}; a "
                f"path has one size"
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
        """Yield the epipolar plane images, one per chosen row, each (V, W, 3)."""
        return (np.stack([rows[index] for rows in self._images]) for index in range(len(self.rows)))

    def look(self, index: int) -> tuple[Image, NDArray[np.float32] | None]:
        """Whole image and depth of a pose, read from the folder.

        Raises:
            MetricError: they were not kept.
        """
        if self.folder is None:
            raise MetricError(
                "wanted the images of the path, got none; name metrics of images when the path is "
                "scored"
            )
        depth = _depth_file(self.folder, index)
        return read_image(_view_file(self.folder, index)), np.load(
            depth
        ) if depth.is_file() else None

    def _add_step(self, *poses: PathPose) -> None:
        before, after = ((pose.camera, pose.image, pose.depth) for pose in poses)
        try:
            self._steps.append(reprojection_step(before, after))
        except MetricError as error:
            self._no_steps = str(error)


@dataclass(frozen=True)
class PathScorer:
    """Computes one or several metrics of a path at once.

    Attributes:
        names: of its values for the whole path; besides metrics these may be numbers that help to
            read them.
        measure: the path -> values; raises `MetricError` where there can be none.
        why_absent: the reason for a name that it leaves out.
        wants_images: whether it works on files of the whole images, which takes seconds: measured
            only where it is named.
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
    """Return the values of the whole path."""
    return [(name, None, value) for name, value in zip(names, values, strict=True)]
