"""Blending: from what each view shows in the target view to one image (Eqs. 4-5)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ggvs_eval.baselines.method import Instant, Map
from ggvs_eval.geometry.per_pixel import weighted_mean
from ggvs_eval.geometry.splat import Splat


@dataclass(frozen=True)
class BlendingInputs:
    """All that blending may look at; the blending network will see the splats and the fused depth of it.

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


class Blender(Protocol):
    """Makes the image; with geometric weights (`GeometricBlender`) or learned ones."""

    def blend(self, inputs: BlendingInputs) -> Map:
        """The target view of one instant, (H, W, 3), float32 in [0, 1]."""


def compose(colours: Sequence[Map], weights: Sequence[Map], background: Map, background_weight: Map) -> Map:
    """Foreground from the weighted views, over the background (Eqs. 4-5).

    Args:
        colours: I_k, each (H, W, 3).
        weights: alpha_k w_k, each (H, W), at least 0; only their ratios matter.
        background: I_BG, (H, W, 3).
        background_weight: w_BG, (H, W), in [0, 1].

    Returns:
        Image, (H, W, 3), float32.

    Reading:
        The denominator of Eq. 4 lacks its sum over k as printed; the normalised sum is meant.
    """
    foreground = weighted_mean(colours, weights)
    return foreground + background_weight[..., None] * (background - foreground)
