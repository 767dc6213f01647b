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
        """Return the mean of the splats; `inputs.depth` would be the fused depth, (H, W)."""
        target, sources = inputs.instant.target, inputs.instant.sources
        distances = [np.linalg.norm(source.camera.centre - target.centre) for source in sources]
        alphas = np.stack([splat.alpha for splat in inputs.splats])  # (K, H, W)
        shares = alphas / np.square(distances)[:, None, None]
        weights = shares / np.maximum(shares.sum(axis=0), 1e-6)
        colours = np.stack([splat.features[..., :3] for splat in inputs.splats])
        return Blended((weights[..., None] * colours).sum(axis=0))
