"""Background memory: what no source sees, as it was seen before, where moving things uncovered it; fillings do not boil."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat
from ggvs_eval.kernels import get_threads

BEHIND = 0.98  # of the remembered depth: what lies so far back at least is the same surface, or one behind it
FORGETTING = 0.99  # of the remembered depth from one instant to the next, so that a wrong one does not last
RENEWAL = 0.15  # share of a new filling in the recursive mean of fillings
SURE_STILL = 0.5  # stillness from which on a pixel is background
FEATHER = 0.5  # share of COVERED_ALPHA below which a pixel is a hole altogether
RULES = (BEHIND, FORGETTING, RENEWAL, SURE_STILL, COVERED_ALPHA, COVERED_ALPHA * FEATHER)  # of the kernel


@dataclass(eq=False)
class _Memory:
    """The farthest that the target saw, (H, W, 3), and its depth, (H, W): 0 of a filling, negative of what moved."""

    index: int
    target: Camera
    image: Map
    depth: Map


class RememberedBackground:
    """Replaces the filling of holes by what the target showed there before, as long as it stands still.

    A pixel that stands still is remembered with its depth unless something behind it is, and forgotten when it begins to move: a
    hole shows the wall that somebody hides from the sources, or has uncovered, and not the body that has left. Where nothing is
    remembered the recursive mean of the fillings is shown, which begins with the first one. State: one image and one depth map of
    the target.

    Reading:
        Not in the paper, whose network invents the background anew in every frame. Off by default: in holes of a validation room
        it gained 0.08 dB with two rows of cameras, and nothing on an arc nor with other exposures (docs/readings.md).
    """

    def __init__(self) -> None:
        self._memory: _Memory | None = None

    def step(self, index: int, target: Camera, image: Map, depth: Map, splats: Sequence[Splat], still: Map) -> Map:
        """The output of an instant with its holes filled from memory.

        Args:
            index: of the instant; after a gap, or from another pose, nothing is remembered.
            target: camera of the output.
            image: blended, holes filled from their surroundings, (H, W, 3), float32; written into.
            depth: fused, (H, W), world units, 0 where unknown.
            splats: forward renderings of the sources; their coverage tells the holes.
            still: how sure it is that nothing moves at each cell, see `stillness`.

        Returns:
            The image.
        """
        memory = self._memory
        if memory is None or memory.index != index - 1 or not memory.target.shows_the_same_rays(target):
            in_hole = reduce(np.maximum, (view.alpha for view in splats)) < COVERED_ALPHA
            self._memory = _Memory(index, target, image.copy(), np.where(in_hole, np.float32(0), depth))
            return image
        from ggvs_eval.kernels import _core

        memory.index = index
        alphas = [np.ascontiguousarray(view.alpha, np.float32) for view in splats]
        seen, image = np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(image, np.float32)
        _core.remember(seen, still, alphas, RULES, image, memory.image, memory.depth, get_threads())
        return image
