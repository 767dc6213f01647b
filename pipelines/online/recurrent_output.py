"""The previous output as one more witness of what stands still: noise and flicker average out over time."""

from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Map, Mask
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.kernels import get_threads, side_by_side
from ggvs_eval.pipelines.online.stillness import LEAST_NOISE, cells, falling, light, mean_square, pooled

DRAGGED = (0.3, 0.8)  # energy that a mean of past images errs by, times that of the noise of one: none and all of it harms


@dataclass(frozen=True, eq=False)
class _Shown:
    """The instant before: its output (H, W, 3), the new image at each cell, and for how many instants that has stood still."""

    index: int
    target: Camera
    image: Map
    new: Map
    age: Map


class RecurrentOutput:
    """Recursive mean of the outputs of one target, cell by cell, as long as nothing moves there.

    What has stood still for n instants is the mean of as many outputs, until the weight of the past reaches its limit. Where
    something moves the past is forgotten at once. State: one output, one image of the cells and one map of ages.

    Args:
        limit: largest weight of the past, below 1; 0 switches it off.

    Raises:
        RenderError: a limit that is no such weight.

    Reading:
        Not in the paper, whose temporal terms smooth depth alone: what the sensors' noise and the edges of the fused depth do to
        the picture passes through them. With geometric weights a limit of 0.85 lowers STED from 18.4 to 17.5, 14.3 to 13.7 and
        30.3 to 28.7 in three domains of a validation room (docs/readings.md) and raises PSNR by 0.01 to 0.03 dB. The limit was
        chosen when stillness was judged by the sources' largest change alone: of 0.25, 0.5, 0.7, 0.85 and 0.92 it was the best.
    """

    def __init__(self, limit: float) -> None:
        if not 0 <= limit < 1:
            raise RenderError(f"recurrent output: the largest weight of the past must be at least 0 and below 1, got {limit:g}")
        self._limit = limit
        self._shown: _Shown | None = None

    def step(self, index: int, target: Camera, image: Map, still: Map) -> Map:
        """The output of an instant.

        Args:
            index: of the instant; after a gap, or from another pose, the past does not count.
            target: camera of the output.
            image: blended, (H, W, 3), float32.
            still: how sure it is that nothing moves at each cell, see `stillness`.

        Returns:
            (H, W, 3), float32.
        """
        if self._limit <= 0:
            return image
        before, age, new = self._shown, np.ones_like(still), cells(image)
        if before is not None and before.index == index - 1 and before.target.shows_the_same_rays(target):
            most = np.float32((1 + self._limit) / (1 - self._limit))  # instants that a mean of such weights is worth
            past, last, now, known = _finite(cells(before.image), before.new, new)
            still = still * agreement(now, past, last, np.minimum(before.age, most)) * known
            age += still * before.age
            weight = still * np.minimum(1 - 1 / age, np.float32(self._limit))
            image = mixed(image, before.image, weight, past - now)
        self._shown = _Shown(index, target, image, new, age)
        return image


def _finite(past: Map, last: Map, new: Map) -> tuple[Map, Map, Map, Mask]:
    """Three images of cells, black where any of them is not finite, and where all are: nothing else has a past."""
    known = np.isfinite(past + last + new).all(axis=2)
    return *(np.where(known[..., None], image, np.float32(0)) for image in (past, last, new)), known


def agreement(new: Map, mean: Map, last: Map, count: Map) -> Map:
    """Rate how well a mean of past images agrees with the new one, (h, w): 1 if noise alone tells them apart, 0 if it drags.

    Args:
        new: image, (h, w, 3), one pixel of each cell.
        mean: of the images before, what is shown.
        last: the image before alone.
        count: of images in the mean, (h, w).

    Reading:
        Of noise of energy N, new in each image, two images differ by 2 N, and one from the mean of n by N (1 + 1 / n), whatever N
        is. What the difference has beyond that is motion that the mean drags along, however slow and faint; motion by more than
        the grain of a texture looks like noise here, and is for the sources to see.
    """
    everywhere = np.ones_like(count)

    def energy(change: Map) -> Map:
        return mean_square(change - light(change, everywhere))

    energies = side_by_side(lambda: energy(new - mean), lambda: energy(new - last))
    dragged, doubled = pooled(np.dstack(energies))
    excess = 2 * dragged / np.maximum(doubled, np.float32(2 * LEAST_NOISE**2)) - (1 + 1 / count)
    return falling(excess, *DRAGGED)


def mixed(image: Map, past: Map, weight: Map, change: Map) -> Map:
    """The past mixed into an image where it has weight and is finite, but for what changed over wide areas.

    Args:
        image: (H, W, 3), float32.
        past: (H, W, 3), float32.
        weight: of the past, one per cell, in [0, 1].
        change: from the image to the past, at each cell, (h, w, 3).

    Reading:
        Light that changes slowly is not seen as motion and would lag behind. The mean difference over about 32 pixels, of what
        stands still, is therefore let through.
    """
    from ggvs_eval.kernels import _core

    change = light(change, weight)
    maps = np.stack([weight, *(weight * change[..., channel] for channel in range(3))])
    now, before = (np.ascontiguousarray(each, np.float32) for each in (image, past))
    return _core.recur(now, before, maps, get_threads())
