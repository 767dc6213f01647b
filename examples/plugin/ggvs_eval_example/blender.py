"""A method: GGVS's splats, blended by the inverse square of the distance to the source cameras."""

import numpy as np

from ggvs_eval.pipelines.online.blending import Blended
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided


class InverseDistance(GeometryGuided):
    """The online method with other weights."""

    def __init__(self):
        """Blend by its own `blend`."""
        super().__init__(blender=self)

    def blend(self, inputs):
        """Return the weighted mean of the splats; `inputs.depth` would be the fused depth, (H, W)."""
        centre = inputs.instant.target.centre
        distances = [np.linalg.norm(source.camera.centre - centre) for source in inputs.instant.sources]
        shares = np.stack([splat.alpha / d**2 for splat, d in zip(inputs.splats, distances, strict=True)])
        weights = shares / np.maximum(shares.sum(axis=0), 1e-6)  # (K, H, W)
        return Blended(sum(w[..., None] * splat.features[..., :3] for w, splat in zip(weights, inputs.splats, strict=True)))
