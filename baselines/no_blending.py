"""No Blending: the Gaussians of all source views in one pass, the nearest opaque one wins."""

from time import perf_counter

from ggvs_eval.baselines.gaussians import near_plane, pixel_gaussians
from ggvs_eval.geometry.splat import splat
from ggvs_eval.method import Instant, Rendering


class NoBlending:
    """Ablation 'No Blending' of the paper.

    Reading:
        The background is black and colours stay premultiplied by coverage, as the reference rasteriser writes them.
    """

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant; nothing is remembered."""
        started = perf_counter()
        gaussians = [pixel_gaussians(source) for source in instant.sources]
        result = splat(gaussians, instant.target, near=near_plane(instant), normalised=False)
        return Rendering(result.features, None, {"splat": perf_counter() - started})
