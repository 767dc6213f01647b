"""The geometry of a camera path for epipolar plane images: one camera that moves along its own rows in equal steps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import MetricError

MIN_POSES = 5
STRAIGHT_PX = 0.5
EVEN_PX = 0.1


@dataclass(frozen=True)
class HorizontalPath:
    """Slopes of the lines in the epipolar plane images of a path.

    Attributes:
        slope_of_unit_depth_px: dx/dv of a point at depth 1, px per pose; negative where the camera moves to its right.
        near: smallest depth seen from the path, world units.
        far: largest depth seen from the path, world units.
    """

    slope_of_unit_depth_px: float
    near: float
    far: float

    def widened(self, factor: float) -> "HorizontalPath":
        """The same path with a depth range that begins nearer and ends farther by this factor."""
        return replace(self, near=self.near / factor, far=self.far * factor)

    def slope_px(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """dx/dv = -f * step / z in px per pose; 0 where the depth is 0, that is unknown."""
        has_depth = depth > 0
        return np.where(has_depth, self.slope_of_unit_depth_px / np.where(has_depth, depth, 1.0), 0.0).astype(np.float32)

    @property
    def slope_range_px(self) -> tuple[float, float]:
        """Smallest and largest slope between near and far, px per pose."""
        ends = self.slope_of_unit_depth_px / self.near, self.slope_of_unit_depth_px / self.far
        return min(ends), max(ends)


def horizontal_path(cameras: Sequence[Camera]) -> HorizontalPath:
    """Check that image rows are epipolar lines and that the steps are equal, and return the slopes.

    Args:
        cameras: poses in order, at least 5.

    Raises:
        MetricError: too few poses, poses that differ in size, intrinsics or orientation, a camera that stands still, or one
            whose way would bend or speed up by more than the EPI's resolution: 0.5 px off the row and 0.1 px per step, both at
            the near end of the depth range.

    Reading:
        The paper's path is "horizontally translating". Along any other path a point leaves its row, and a row over poses is no
        epipolar plane image; such a path is refused instead of being scored.
    """
    if len(cameras) < MIN_POSES:
        raise MetricError(f"an epipolar plane image wants at least {MIN_POSES} poses, the path has {len(cameras)}; add poses")
    first = cameras[0]
    for camera in cameras[1:]:
        same = camera.size == first.size and np.allclose(camera.K, first.K, atol=1e-3)
        if not same or not np.allclose(camera.rotation, first.rotation, atol=1e-5):
            raise MetricError(
                f"pose {camera.name}: size, intrinsics or orientation differ from {first.name}'s; an epipolar plane image wants "
                "a camera that only moves sideways"
            )
    near, far = min(camera.near for camera in cameras), max(camera.far for camera in cameras)
    step = _even_step(np.array([first.rotation @ (camera.centre - first.centre) for camera in cameras]), first, near)
    return HorizontalPath(-float(first.K[0, 0]) * step, near, far)


def _even_step(offsets: NDArray[np.float64], camera: Camera, near: float) -> float:
    """Step in world units along x of centres (V, 3) in the first pose's frame."""
    step = float(offsets[-1, 0]) / (len(offsets) - 1)
    if step == 0 or not np.isfinite(step):
        raise MetricError(f"pose {camera.name}: the camera ends where it began along its rows; an EPI wants a moving camera")
    down_px, ahead_px = np.abs(offsets[:, 1:]).max(axis=0) * (camera.K[1, 1], max(camera.size) / 2) / near
    if max(down_px, ahead_px) > STRAIGHT_PX:
        raise MetricError(
            f"pose {camera.name}: points leave their row by up to {max(down_px, ahead_px):.2f} px along the path, at most "
            f"{STRAIGHT_PX:g} px make an epipolar plane image; move the camera along its own rows"
        )
    uneven_px = float(np.abs(np.diff(offsets[:, 0]) - step).max() * camera.K[0, 0] / near)
    if uneven_px > EVEN_PX:
        raise MetricError(f"pose {camera.name}: steps differ by {uneven_px:.2f} px, at most {EVEN_PX:g} px; use equal steps")
    return step
