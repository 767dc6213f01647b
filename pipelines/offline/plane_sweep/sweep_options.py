"""The parameters of the plane sweep."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PlaneSweep:
    """Planes swept through all partners at once, then semi-global matching over them along eight paths (Hirschmueller 2008).

    The planes lie evenly in inverse depth. The cost of a pixel on a plane is one minus the normalised cross-correlation of its
    window with the partners', 0 to 1. Matching goes from a small image to the full one: what the small one finds says which
    planes are worth a look, and which partners see a point.

    Attributes:
        step_px: from plane to plane, points move by this much in the image of the widest partner, pixels.
        most_planes: at most so many, in steps of 32 and not above 256; where they do not suffice, they lie farther apart.
        radius_px: of the correlated window, 1 to 3.
        colour_scale: a pixel of the window counts less than half where its colour differs by this much, grey values.
        noise: variance of grey values that is no texture.
        small_step: penalty of a step of one plane between neighbours, in units of the cost.
        large_step: penalty of a larger step, on a surface of one grey.
        edge_grey: where neighbours differ by so many grey values, a larger step costs half of that.
        smallest_px: the image is halved until its longer side is at most this.
        search_planes: how far around what the smaller image found planes are looked at.
        median_radius_px: depth edges are moved to those of the image by a median over windows of this radius; 0 leaves them.
        median_colour: in that median, a pixel's weight falls by e for so many grey values of difference.
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
