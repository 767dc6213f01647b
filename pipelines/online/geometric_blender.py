"""Geometric weights in place of the blending network: trust views that see the fused surface, those near the target most."""

from collections.abc import Sequence
from dataclasses import dataclass

from ggvs_eval.arrays import Map
from ggvs_eval.geometry.per_pixel import weighted_mean
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat
from ggvs_eval.geometry.view_weights import view_weights
from ggvs_eval.geometry.warp import CapturedView, look_up
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs
from ggvs_eval.pipelines.online.inpainting import push_pull


@dataclass(frozen=True)
class GeometricBlender:
    """Weights from visibility and the angle between the cameras; holes are filled from their surroundings.

    Where the ray march found a surface each view is sampled at it (backward warp) and counts as far as its own depth agrees.
    Where it found none, or no view agrees, the splatted views show through; where they show nothing, the hole is filled from
    its surroundings.

    Attributes:
        tolerance_tau: difference of depths, in truncation distances, up to which a view is taken to see the fused surface.
        background: fill what no view shows from its surroundings; black without (ablation 'background blending off').

    Reading:
        The paper learns to blend splatted views. Splats are blurred by the Gaussians' footprint; a network can learn to undo
        that, fixed weights cannot, so this blender samples the images at the fused depth instead, bicubically: nine views of the
        validation rooms (demo seeds 101-103) score 30.68 dB, bilinearly 30.41 dB.
    """

    tolerance_tau: float = 1.0
    background: bool = True

    def blend(self, inputs: BlendingInputs) -> Blended:
        """The target view of one instant."""
        sources = inputs.instant.sources
        cameras, shares = [source.camera for source in sources], [source.share for source in sources]
        weights = view_weights(inputs.instant.target, cameras, shares).tolist()
        views = [
            CapturedView(source.camera, source.image, depth, weight)
            for source, depth, weight in zip(sources, inputs.filtered_depths, weights, strict=True)
        ]
        tolerance = self.tolerance_tau * inputs.tau
        background = self._background(inputs.splats, weights)
        return Blended(look_up(inputs.instant.target, inputs.depth, views, background, tolerance))

    def _background(self, splats: Sequence[Splat], weights: Sequence[float]) -> Map:
        """The splatted views' weighted mean, holes filled or black."""
        alphas = [view.alpha for view in splats]
        mean = weighted_mean([view.features for view in splats], alphas, weights)
        covered = alphas[0] > COVERED_ALPHA
        for alpha in alphas[1:]:
            covered |= alpha > COVERED_ALPHA
        return push_pull(mean, covered) if self.background else mean * covered[..., None]
