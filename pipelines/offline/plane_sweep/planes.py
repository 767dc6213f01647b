"""The parameters of a plane sweep, and the spacing of its planes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array, Map
from ggvs_eval.camera import Camera

BLOCK = 32  # planes come in multiples of it, as the kernels want them
SMALLEST_DENOMINATOR = 0.1  # nearer to a partner's centre nothing is matched; the kernels' number
SAMPLED_PX = 8  # pixels between samples of parallax


@dataclass(frozen=True)
class PlaneSweep:
    """Planes swept through all partners at once, then semi-global matching over them along eight paths (Hirschmueller 2008).

    The planes are evenly in inverse depth. The cost of a pixel on a plane is one minus the normalised cross-correlation of its
    window with the partners', 0 to 1. Matching goes from a small image to the full one: what the small one finds says which
    planes are worth a look, and which partners see a point.

    Attributes:
        step_px: from plane to plane, points move by this much in the image of the widest partner, pixels.
        most_planes: maximum number, in steps of 32 and not above 256; where it does not suffice, they are farther apart.
        radius_px: of the correlated window, 1 to 3.
        colour_scale: a pixel of the window counts less than half where its colour differs by this much, grey values.
        noise: variance of grey values that is no texture.
        small_step: penalty of a step of one plane between neighbours, in units of the cost.
        large_step: penalty of a larger step, on a surface of one grey.
        edge_grey: difference of grey values of neighbours at which a larger step costs half.
        smallest_px: the image is halved until its longer side is at most this.
        search_planes: how far around what the smaller image found planes are looked at.
        median_radius_px: depth edges are moved to those of the image by a median over windows of this radius; 0 leaves them.
        median_colour: in that median, a pixel's weight falls by e for this difference of grey values.
        refinements: Gauss-Newton steps on the images, which find the fraction of a plane.
    """

    step_px: float = 0.5
    most_planes: int = 192
    radius_px: int = 2
    colour_scale: float = 20.0
    noise: float = 0.5
    small_step: float = 0.06
    large_step: float = 0.6
    edge_grey: float = 10.0
    smallest_px: int = 360
    search_planes: int = 4
    median_radius_px: int = 5
    median_colour: float = 7.0
    refinements: int = 1

    @property
    def name(self) -> str:
        """Names the algorithm."""
        return "plane-sweep"


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


def plan_planes(camera: Camera, partners: Sequence[Camera], step_px: float, most: int) -> SweepPlanes:
    """Planes from the camera's far to its near, and one beyond on either side.

    Args:
        step_px: from plane to plane, points move by this much in the image of the widest partner, pixels.
        most: number of planes at most; a step is longer where they do not suffice.
    """
    far, near = 1 / camera.far, 1 / camera.near
    parallax = max(_median_parallax(camera, partner, far, near) for partner in partners)
    n_planes = int(np.ceil(parallax / step_px)) + 3
    count = max(min(-(-n_planes // BLOCK) * BLOCK, most // BLOCK * BLOCK), BLOCK)
    step = (near - far) / (count - 3)
    return SweepPlanes(max(far - step, 0.2 * far), step, count)


def _median_parallax(camera: Camera, partner: Camera, far: float, near: float) -> float:
    """Measure the median motion of pixels in the partner's image between two inverse depths, pixels of the camera."""
    towards = camera.rotation @ (partner.centre - camera.centre)
    rays = (camera.pixel_centres()[::SAMPLED_PX, ::SAMPLED_PX] - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]

    def project(inverse_depth: float) -> Array:
        return (rays - towards[:2] * inverse_depth) / max(1 - towards[2] * inverse_depth, SMALLEST_DENOMINATOR)

    return float(np.median(np.linalg.norm(project(near) - project(far), axis=-1))) * camera.focal_px
