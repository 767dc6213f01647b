"""Geometric weights in place of the blending network: trust the views that see the fused surface, the nearest camera most."""

from dataclasses import dataclass

import numpy as np

from ggvs_eval.baselines.distance_based import distance_weights
from ggvs_eval.baselines.method import Map, SourceView
from ggvs_eval.geometry.warp import warp
from ggvs_eval.pipelines.online.blending import BlendingInputs, compose, weighted_mean
from ggvs_eval.pipelines.online.inpainting import push_pull


@dataclass(frozen=True)
class GeometricBlender:
    """Weights from visibility and camera distance; holes are filled from their surroundings.

    Where the ray march found a surface each view is sampled at it (backward warp) and counts as far as its own depth agrees.
    Where it found none, or no view agrees, the splatted views show through; where they show nothing, the hole is filled from
    its surroundings.

    Attributes:
        tolerance_tau: difference of depths, in truncation distances, up to which a view is taken to see the fused surface.

    Reading:
        The paper learns to blend splatted views. Splats are blurred by the Gaussians' footprint; a network can learn to undo
        that, fixed weights cannot, so this blender samples the images at the fused depth instead.
    """

    tolerance_tau: float = 1.0

    def blend(self, inputs: BlendingInputs) -> Map:
        """The target view of one instant, (H, W, 3)."""
        near_weights = distance_weights(inputs.instant.target, [source.camera for source in inputs.instant.sources])
        splat_colours = [view.features[..., :3] for view in inputs.splats]
        splat_weights = [view.alpha * np.float32(weight) for view, weight in zip(inputs.splats, near_weights, strict=True)]
        fallback = weighted_mean(splat_colours, splat_weights)
        covered = np.max([view.alpha for view in inputs.splats], axis=0) > 0.5
        background = push_pull(fallback, covered)
        colours, weights = self._warp_views(inputs, near_weights)
        seen = np.minimum(np.sum(weights, axis=0) / np.float32(max(near_weights)), np.float32(1))
        return compose(colours, weights, background, 1 - seen)

    def _warp_views(self, inputs: BlendingInputs, near_weights: list[float]) -> tuple[list[Map], list[Map]]:
        """Each source image at the fused surface, and its weight: visibility times distance weight."""
        colours, weights = [], []
        for source, depth, near in zip(inputs.instant.sources, inputs.filtered_depths, near_weights, strict=True):
            warped = warp(
                inputs.instant.target, inputs.depth, source.camera, _as_float(source), depth, self.tolerance_tau * inputs.tau
            )
            colours.append(warped.colour)
            weights.append(warped.visibility * np.float32(near))
        return colours, weights


def _as_float(source: SourceView) -> Map:
    return source.image.astype(np.float32) / np.float32(255)
