"""What the online method hands to its blender, for tests of blenders alone."""

import numpy as np

from ggvs_eval.method import Instant
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided


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
