"""What a blender is given, and what it is: from the views in the target view to one image (Eqs. 4-5)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ggvs_eval.arrays import Map
from ggvs_eval.geometry.splat import Splat
from ggvs_eval.method import Instant


@dataclass(frozen=True)
class BlendingInputs:
    """All that blending may look at; the blending network sees the splats and the fused depth of it.

    Attributes:
        instant: source views and cameras, target camera.
        filtered_depths: temporally filtered depth of each source view, in its own image.
        splats: forward rendering of each view in the target view: colour, coverage, depth.
        depth: fused depth of the ray march in the target view, (H, W), world units, zero where unknown.
        tau: truncation distance of the fusion, world units.
    """

    instant: Instant
    filtered_depths: Sequence[Map]
    splats: Sequence[Splat]
    depth: Map
    tau: float


@dataclass(frozen=True, eq=False)
class Blended:
    """What a blender makes.

    Attributes:
        image: the target view of one instant, (H, W, 3), float32 in [0, 1].
        weights: share of each source view in it, nearest camera first, (K, h, w) at its size or less, the rest is the
            background's; None if it does not tell.
    """

    image: Map
    weights: Map | None = None


class Blender(Protocol):
    """Makes the image; with geometric weights (`GeometricBlender`) or learned ones."""

    def blend(self, inputs: BlendingInputs) -> Blended:
        """The target view of one instant."""
