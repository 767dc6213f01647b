"""Reprojection from one pose of a camera path to the next, by depth, and comparison there."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import MetricError
from ggvs_eval.geometry import warp
from ggvs_eval.metrics.inputs import Image, check_pair, white_level

DEPTH_TOLERANCE = 0.02
OVER_RGB = np.full(3, 1 / 3, np.float32)  # the mean over channels, as a product: numpy's own is ten times slower
Pose = tuple[Camera, Image, NDArray[np.float32] | None]


@dataclass(frozen=True)
class StepError:
    """Difference between a pose and the pose before it, carried over by depth.

    Attributes:
        error_255: mean absolute colour difference over co-visible pixels and channels, grey levels of 255; None where by their
            depths the two poses see no surface in common.
        visible_share: co-visible pixels of all pixels.
        texture_255: mean absolute horizontal difference of neighbouring pixels there, grey levels of 255; None like the error.
        squared_error: mean squared colour difference there, white is 1; None like the error.
    """

    error_255: float | None
    visible_share: float
    texture_255: float | None
    squared_error: float | None


def reprojection_steps(poses: Iterable[Pose], depth_tolerance: float = DEPTH_TOLERANCE) -> list[StepError]:
    """Reprojection error of every step along a path.

    Args:
        poses: camera, image (H, W, 3) uint8 in 0..255 or float in [0, 1], and depth (H, W) float32, world units, 0 = unknown;
            in order, any kind of path; consumed as a stream, two poses in memory.
        depth_tolerance: see `reprojection_step`.

    Returns:
        One error per step, V - 1 of them.
    """
    steps = [reprojection_step(before, after, depth_tolerance) for before, after in pairwise(poses)]
    if not steps:
        raise MetricError("reprojection compares neighbouring poses: wanted at least 2 poses on the path; add poses")
    return steps


def reprojection_step(before: Pose, after: Pose, depth_tolerance: float = DEPTH_TOLERANCE) -> StepError:
    """Carry a pose's image to the next pose and compare the two there.

    Args:
        depth_tolerance: the poses see one surface where their depths differ by less than this share of the median depth;
            visibility falls to 0 at twice this.

    Reading:
        Not in the paper. Colours are sampled with Catmull-Rom splines, so that interpolation hardly blurs. Visibility weights
        the mean. Depths that contradict each other make pixels invisible, not wrong: they lower `visible_share`.
    """
    cameras = before[0], after[0]
    depths = [checked_depth(camera, depth) for camera, _, depth in (before, after)]
    images = [_checked_image(camera, image) for camera, image, _ in (before, after)]
    check_pair(before[1], after[1])
    valid_depths = depths[1][depths[1] > 0]
    if not valid_depths.size:
        return StepError(None, 0.0, None, None)
    tolerance = depth_tolerance * float(np.median(valid_depths))
    carried = warp(cameras[1], depths[1], cameras[0], images[0], depths[0], tolerance, bicubic=True)
    weight = float(carried.visibility.sum(dtype=np.float64))
    if not weight:
        return StepError(None, 0.0, None, None)
    difference = carried.colour - images[1]
    texture = np.abs(np.diff(images[1], axis=1)) @ OVER_RGB
    error, squared, texture_there = (
        float((carried.visibility[:, -each.shape[1] :] * each).sum(dtype=np.float64)) / weight
        for each in (np.abs(difference) @ OVER_RGB, np.square(difference) @ OVER_RGB, texture)
    )
    return StepError(255 * error, weight / carried.visibility.size, 255 * texture_there, squared)


def _checked_image(camera: Camera, image: Image) -> NDArray[np.float32]:
    """The image as float32 in [0, 1]."""
    if image.shape != (camera.height, camera.width, 3):
        raise MetricError(f"pose {camera.name}: wanted an image {camera.height} x {camera.width} x 3, got {image.shape}")
    return image.astype(np.float32) / np.float32(white_level(image))


def checked_depth(camera: Camera, depth: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """The depth of a pose if it has one that fits its camera."""
    if depth is None:
        raise MetricError(f"pose {camera.name}: no depth; wanted depth along the path")
    if depth.shape != (camera.height, camera.width) or not np.isfinite(depth).all() or (depth < 0).any():
        raise MetricError(
            f"pose {camera.name}: wanted depths >= 0 of {camera.height} x {camera.width}, 0 = unknown, got {depth.shape} with "
            f"{np.count_nonzero(~(np.isfinite(depth) & (depth >= 0)))} bad values"
        )
    return depth
