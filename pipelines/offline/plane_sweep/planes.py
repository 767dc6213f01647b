"""The spacing of the planes of a sweep."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array, Map
from ggvs_eval.camera import Camera

BLOCK = 32  # planes come in multiples of it, as the kernels want them
SMALLEST_DENOMINATOR = 0.1  # nearer to a partner's centre nothing is matched; the kernels' number
SAMPLED_PX = 8  # pixels between samples of parallax


@dataclass(frozen=True)
class SweepPlanes:
    """Planes of constant depth, evenly spaced in inverse depth from far to near.

    Attributes:
        first: inverse depth of the first plane, 1 / world units.
    """

    first: float
    step: float
    count: int

    def inverse_depths(self) -> Array:
        """Of every plane, (count,)."""
        return self.first + self.step * np.arange(self.count, dtype=np.float64)

    def inverse_depth_of(self, surface: Map) -> Map:
        """Return the inverse depth of a surface given in planes, (H, W)."""
        return (self.first + self.step * surface).astype(np.float32)


def plan_planes(
    camera: Camera, partners: Sequence[Camera], step_px: float, most: int
) -> SweepPlanes:
    """Planes from the camera's far to its near, and one beyond on either side.

    Args:
        step_px: from plane to plane, points move by this much in the image of the widest partner,
            pixels.
        most: number of planes at most; a step is longer where they do not suffice.
    """
    far, near = 1 / camera.far, 1 / camera.near
    parallax = max(_median_parallax(camera, partner, far, near) for partner in partners)
    n_planes = int(np.ceil(parallax / step_px)) + 3
    count = max(min(-(-n_planes // BLOCK) * BLOCK, most // BLOCK * BLOCK), BLOCK)
    step = (near - far) / (count - 3)
    return SweepPlanes(max(far - step, 0.2 * far), step, count)


def _median_parallax(camera: Camera, partner: Camera, far: float, near: float) -> float:
    """Measure the median motion of pixels in the partner's image between two inverse depths, pixels
    of the camera.
    """
    towards = camera.rotation @ (partner.centre - camera.centre)
    rays = (camera.pixel_centres()[::SAMPLED_PX, ::SAMPLED_PX] - camera.K[:2, 2]) / camera.K[
        [0, 1], [0, 1]
    ]

    def project(inverse_depth: float) -> Array:
        return (rays - towards[:2] * inverse_depth) / max(
            1 - towards[2] * inverse_depth, SMALLEST_DENOMINATOR
        )

    return float(np.median(np.linalg.norm(project(near) - project(far), axis=-1))) * camera.focal_px
