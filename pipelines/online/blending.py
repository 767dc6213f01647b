"""Blenders, from the views in the target view to one image (Eqs. 4-5): their inputs, their
interface, the geometric one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.geometry.per_pixel import view_weights, weighted_mean
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat
from ggvs_eval.geometry.warp import look_up
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import Instant

FORGIVEN_PX = 0.5  # an error that moves what a view shows by less leaves it in its pixel


@dataclass(frozen=True)
class BlendingInputs:
    """All that blending may look at.

    The blending network sees the splats and the fused depth of it.

    Attributes:
        instant: target camera and source views, their depth temporally filtered.
        splats: forward rendering of each view in the target view: colour, coverage, depth.
        depth: fused depth of the ray march in the target view, (H, W), world units, zero where
            unknown.
        tau: truncation distance of the fusion, world units.
        forgiven_px: errors of depth that hide no surface, see `ggvs_eval.geometry.warp.forgiven`,
            pixels of a source.
    """

    instant: Instant
    splats: Sequence[Splat]
    depth: Map
    tau: float
    forgiven_px: float = FORGIVEN_PX


@dataclass(frozen=True, eq=False)
class Blended:
    """Result of a blender.

    Attributes:
        image: the target view of one instant, (H, W, 3), float32 in [0, 1].
        weights: share of each source view in it, nearest camera first, (K, h, w) at its size or
            less, the rest is the background's; None if unknown.
    """

    image: Map
    weights: Map | None = None


class Blender(Protocol):
    """Makes the image; with geometric weights (`GeometricBlender`) or learned ones."""

    def blend(self, inputs: BlendingInputs) -> Blended:
        """Return the target view of one instant."""


def push_pull(colour: Map, covered: NDArray[np.bool_], out: Map | None = None) -> Map:
    """Fill unknown pixels from ever coarser averages of the known ones (push-pull, Gortler et al.
    1996).

    Args:
        colour: (H, W, 3), float32; values of unknown pixels are ignored.
        covered: (H, W).
        out: where the image is written, contiguous; may be `colour` itself. A new array unless
            given.

    Returns:
        Image, (H, W, 3), float32; known pixels keep their colour.
    """
    from ggvs_eval.kernels import _core

    colour = np.ascontiguousarray(colour, np.float32)
    filled = _core.empty(colour.shape) if out is None else out
    _core.push_pull(colour, np.ascontiguousarray(covered, np.bool_), filled, get_threads())
    return filled


@dataclass(frozen=True)
class GeometricBlender:
    """Weights from visibility and the angle between the cameras.

    Holes are filled from their surroundings.

    Where the ray march found a surface each view is sampled at it (backward warp) and counts as far
    as its own depth agrees. Where it found none, or no view agrees, the splatted views show
    through; where they show nothing, the hole is filled from its surroundings.

    Attributes:
        tolerance_tau: difference of depths, in truncation distances, up to which a view is taken to
            see the fused surface.
        background: fill what no view shows from its surroundings; black without (ablation
            'background blending off').

    Reading:
        The paper learns to blend splatted views. Splats are blurred by the Gaussians' footprint; a
        network can learn to undo that, fixed weights cannot, so this blender samples the images at
        the fused depth instead, bicubically: nine views of the validation rooms (demo seeds
        101-103) score 30.68 dB, bilinearly 30.41 dB.
    """

    tolerance_tau: float = 1.0
    background: bool = True

    def blend(self, inputs: BlendingInputs) -> Blended:
        """Return the target view of one instant."""
        sources = inputs.instant.sources
        cameras, shares = (
            [source.camera for source in sources],
            [source.share for source in sources],
        )
        weights = view_weights(inputs.instant.target, cameras, shares).tolist()
        tolerance = self.tolerance_tau * inputs.tau
        background = self._background(inputs.splats, weights)
        return Blended(
            look_up(
                inputs.instant.target,
                inputs.depth,
                sources,
                weights,
                background,
                tolerance,
                inputs.forgiven_px,
            )
        )

    def _background(self, splats: Sequence[Splat], weights: Sequence[float]) -> Map:
        """Return the splatted views' weighted mean, holes filled or black."""
        alphas = [view.alpha for view in splats]
        mean = weighted_mean([view.features for view in splats], alphas, weights)
        covered = alphas[0] > COVERED_ALPHA
        for alpha in alphas[1:]:
            covered |= alpha > COVERED_ALPHA
        return push_pull(mean, covered, out=mean) if self.background else mean * covered[..., None]
