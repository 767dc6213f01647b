"""Background memory: what no source sees, as it was seen before, where moving things uncovered it; fillings do not boil."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat

BEHIND = 0.98  # of the remembered depth: what lies so far back at least is the same surface, or one behind it
FORGETTING = 0.99  # of the remembered depth from one instant to the next, so that a wrong one does not last
RENEWAL = 0.15  # share of a new filling in the recursive mean of fillings
SURE_STILL = 0.5  # stillness from which on a pixel is background
FEATHER = 0.5  # share of COVERED_ALPHA below which a pixel is a hole altogether


@dataclass(eq=False)
class _Memory:
    """The farthest that the target saw at each pixel: colour (H, W, 3) and depth (H, W), 0 where it is but a filling."""

    index: int
    target: Camera
    image: Map
    depth: Map


class RememberedBackground:
    """Replaces the filling of holes by what the target showed there before, as long as it stands still.

    A pixel that stands still is remembered with its depth unless something behind it is, and forgotten when it begins to move: a
    hole shows the wall that somebody hides from the sources, or has uncovered, and not the body that has left. Where nothing is
    remembered the recursive mean of the fillings is shown. State: one image and one depth map of the target.

    Reading:
        Not in the paper, whose network invents the background anew in every frame.
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
        alpha = largest_alpha(splats)
        in_hole = cv2.compare(alpha, COVERED_ALPHA, cv2.CMP_LT)
        memory = self._memory
        if memory is None or memory.index != index - 1 or not memory.target.shows_the_same_rays(target):
            self._memory = _Memory(index, target, image.copy(), np.where(in_hole > 0, np.float32(0), depth))
            return image
        memory.index = index
        _remember(memory, image, depth, in_hole, still)
        self._fill(memory, image, alpha, in_hole)
        return image

    def _fill(self, memory: _Memory, image: Map, alpha: Map, in_hole: NDArray[np.uint8]) -> None:
        """Put memory into the holes; fillings that stand for nothing seen are renewed a little."""
        at = np.flatnonzero(in_hole)
        past, new = memory.image.reshape(-1, 3), image.reshape(-1, 3)
        guessed = at[memory.depth.ravel()[at] <= 0]
        past[guessed] += np.float32(RENEWAL) * (new[guessed] - past[guessed])
        new[at] += hole_weight(alpha.ravel()[at])[:, None] * (past[at] - new[at])


def largest_alpha(splats: Sequence[Splat]) -> Map:
    """The largest coverage by any source, (H, W)."""
    return reduce(cv2.max, (view.alpha for view in splats))


def hole_weight(alpha: Map) -> Map:
    """Return how far a pixel of that coverage is a hole: 0 from `COVERED_ALPHA` up, 1 from half of it down."""
    return np.clip((COVERED_ALPHA - alpha) / (COVERED_ALPHA * (1 - FEATHER)), 0, 1).astype(np.float32)


def _remember(memory: _Memory, image: Map, depth: Map, in_hole: NDArray[np.uint8], still: Map) -> None:
    """Note what is seen now where nothing behind it is remembered; what moves is no background."""
    cv2.multiply(memory.depth, FORGETTING, dst=memory.depth)
    farthest = cv2.compare(depth, cv2.multiply(memory.depth, BEHIND), cv2.CMP_GE)
    mask = cv2.bitwise_and(cv2.bitwise_and(farthest, cv2.compare(depth, 0, cv2.CMP_GT)), cv2.bitwise_not(in_hole))
    quiet = cv2.resize(cv2.compare(still, SURE_STILL, cv2.CMP_GE), depth.shape[::-1], interpolation=cv2.INTER_NEAREST)
    cv2.copyTo(image, mask, memory.image)
    cv2.copyTo(depth, mask, memory.depth)
    memory.depth[cv2.bitwise_and(mask, cv2.bitwise_not(quiet)) > 0] = 0
