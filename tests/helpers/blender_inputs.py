"""What the online method hands to its blender, for tests of blenders alone."""

import numpy as np

from ggvs_eval.method import Instant
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.online.network_inputs import BlendMaps
from helpers.geometry_scenes import random_camera, random_depth


class Keep:
    """A blender that keeps what it is given."""

    def blend(self, inputs: BlendingInputs) -> Blended:
        """Nothing to see."""
        self.inputs = inputs
        return Blended(np.zeros((*inputs.depth.shape, 3), np.float32))


def inputs_of(moment: Instant) -> BlendingInputs:
    """What the online method hands to its blender."""
    keeper = Keep()
    GeometryGuided(blender=keeper).step(moment)
    return keeper.inputs


def random_maps(random: np.random.Generator, width: int, height: int, views: int) -> BlendMaps:
    """Views that show nothing in places, over a surface with edges and holes."""
    target, size = random_camera(random, width, height, "target"), (views, height, width)
    seen = np.clip(random.normal(0.5, 0.6, size), 0, 1).astype(np.float32)
    alphas, colours = (
        random.random(size, dtype=np.float32),
        random.random((*size, 3), dtype=np.float32),
    )
    depths = tuple(random_depth(random, target) for _ in range(views))
    sources = tuple(random_camera(random, 20, 15, f"source {k}") for k in range(views))
    coverage = np.maximum(seen, np.float32(0.02) * alphas)
    return BlendMaps(
        target,
        sources,
        colours,
        coverage,
        seen,
        tuple(alphas),
        depths,
        random_depth(random, target),
    )
