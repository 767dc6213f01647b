"""The paper's two ablations that blend splatted views by a rule: the nearest wins, or near cameras
weigh more.
"""

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.per_pixel import weighted_mean
from ggvs_eval.geometry.splat import splat
from ggvs_eval.method import Instant, Rendering

DEPTH_PLANES = 32  # LLFF's number of planes of a multi-plane image


class NoBlending:
    """Ablation 'No Blending' of the paper.

    Reading:
        The background is black and colours stay premultiplied by coverage, as the reference
        rasteriser writes them.
    """

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant; nothing is remembered."""
        started = perf_counter()
        result = splat(instant.sources, instant.target, near=instant.near_plane, normalised=False)
        return Rendering(result.features, None, {"splat": perf_counter() - started})


class DistanceBased:
    """Ablation 'Distance-based Blending' of the paper, after LLFF (Mildenhall et al. 2019).

    Reading:
        w_k = exp(-gamma |C_k - C_target|) with LLFF's gamma = f / (P z0), f in pixels, P planes
        (32), z0 the nearest depth. There is no background term: what no view covers stays black.
        LLFF adds 1e-10 to the sum of weights; at full size far views weigh less than that and would
        come out black, so nothing is added.
    """

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant; nothing is remembered."""
        started = perf_counter()
        splats = [
            splat([source], instant.target, near=instant.near_plane) for source in instant.sources
        ]
        splatted = perf_counter()
        weights = distance_weights(instant.target, [source.camera for source in instant.sources])
        image = weighted_mean(
            [view.features for view in splats], [view.alpha for view in splats], weights
        )
        return Rendering(
            image, None, {"splat": splatted - started, "blend": perf_counter() - splatted}
        )


def distance_weights(target: Camera, cameras: Sequence[Camera]) -> list[float]:
    """LLFF's weight of each source camera.

    Only their ratios matter, so the nearest one has weight 1.
    """
    gamma = target.focal_px / (DEPTH_PLANES * min(camera.near for camera in cameras))
    distances = np.array([np.linalg.norm(camera.centre - target.centre) for camera in cameras])
    return list(np.exp(-gamma * (distances - distances.min())))
