"""The previous output as one more witness of what stands still: noise and flicker average out over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat
from ggvs_eval.kernels import get_threads

REDUCTION = 4  # stillness is decided at a quarter of the size, as the difference masks are
REACH = 2  # cells: what no view covers moves as its surroundings do
QUIET_QUANTILE = 0.25  # so much of the picture at least is taken to stand still
QUIET_RANGE = (0.5 / 255, 3.0 / 255)  # what the sensors' noise may be, as it shows in the difference masks
STILL, MOVING = 2.0, 4.0  # times the noise
LIGHT_PX = 32  # changes as wide as this are light, and are let through


@dataclass(frozen=True, eq=False)
class _Shown:
    """Output of the instant before, (H, W, 3), its camera, and for how many instants each cell has stood still."""

    index: int
    target: Camera
    image: Map
    age: Map


class RecurrentOutput:
    """Recursive mean of the outputs of one target, cell by cell, as long as nothing moves there.

    What has stood still for n instants is the mean of as many outputs, until the weight of the past reaches its limit. Where
    something moves the past is forgotten at once. State: one output and one map of ages.

    Args:
        limit: largest weight of the past, below 1; 0 switches it off.

    Raises:
        RenderError: a limit that is no such weight.

    Reading:
        Not in the paper, whose temporal terms smooth depth alone: what the sensors' noise and the edges of the fused depth do to
        the picture passes through them. In two validation rooms (demo seeds 101 and 102, one view each, 32 frames, noise of
        1.5/255, shipped network) a limit of 0.85 lowers STED from 13.53 to 10.30 and from 9.03 to 6.98 and raises PSNR by 0.13
        and 0.08 dB; held still it lowers STED from 26.5 to 8.0 and from 22.2 to 7.4. In the first room limits of 0.25, 0.5, 0.7
        and 0.92 gave 12.07, 11.05, 10.45 and 10.32.
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
        before, age = self._shown, np.ones_like(still)
        if before is not None and before.index == index - 1 and before.target.shows_the_same_rays(target):
            age += still * before.age
            image = mixed(image, before.image, still * np.minimum(1 - 1 / age, np.float32(self._limit)))
        self._shown = _Shown(index, target, image, age)
        return image


def splatted_change(splats: Sequence[Splat], beta_mask: float, lambda_t: float) -> Map:
    """The largest change of colour that a source sees at each cell and next to it: Eq. 1 undone, in the target view.

    Args:
        splats: forward renderings whose fourth feature is the difference mask.
        beta_mask: as in `difference_mask`.
        lambda_t: as in `difference_mask`.

    Returns:
        Absolute difference of colours, (ceil(H / 4), ceil(W / 4)), 0 where neither a cell nor its neighbours are covered.
    """
    mask = np.zeros_like(splats[0].alpha[::REDUCTION, ::REDUCTION])
    for view in splats:
        covers = view.alpha[::REDUCTION, ::REDUCTION] >= COVERED_ALPHA
        np.maximum(mask, view.features[::REDUCTION, ::REDUCTION, 3], out=mask, where=covers)
    size = 2 * REACH + 1
    widest = cv2.dilate(mask, np.ones((size, size), np.uint8))
    return np.asarray(np.maximum(widest - np.float32(beta_mask), 0) * np.float32(lambda_t), np.float32)


def stillness(change: Map) -> Map:
    """Rate how sure it is that nothing moves: 1 up to twice the noise, 0 from four times the noise on.

    Args:
        change: of colour at each cell as the sources see it, see `splatted_change`.

    Reading:
        The noise is the change that a quarter of the picture does not exceed, within bounds: a fixed threshold would have to be
        set for every sensor.
    """
    noise = np.clip(np.quantile(change, QUIET_QUANTILE), *QUIET_RANGE)
    return np.clip((MOVING - change / np.float32(noise)) / (MOVING - STILL), 0, 1).astype(np.float32)


def mixed(image: Map, past: Map, weight: Map) -> Map:
    """The past mixed into an image where it has weight, but for what changed over wide areas.

    Args:
        image: (H, W, 3), float32.
        past: (H, W, 3), float32.
        weight: of the past, one per cell, in [0, 1].

    Reading:
        Light that changes slowly is not seen as motion and would lag behind. The mean difference over about 32 pixels, of what
        stands still, is therefore let through.
    """
    from ggvs_eval.kernels import _core

    light = _wide(past[::REDUCTION, ::REDUCTION] - image[::REDUCTION, ::REDUCTION], weight)
    cells = np.stack([weight, *(weight * light[..., channel] for channel in range(3))])
    now, before = (np.ascontiguousarray(each, np.float32) for each in (image, past))
    return _core.recur(now, before, cells, get_threads())


def _wide(difference: Map, weight: Map) -> Map:
    """The weighted mean of a difference over wide areas, one per cell."""
    cells = LIGHT_PX // REDUCTION
    small = (-(-weight.shape[1] // cells), -(-weight.shape[0] // cells))
    parts = np.concatenate([difference * weight[..., None], weight[..., None]], axis=-1)
    sums = cv2.GaussianBlur(cv2.resize(parts, small, interpolation=cv2.INTER_AREA), (0, 0), 1)
    mean = sums[..., :3] / (sums[..., 3:] + np.float32(1e-3))
    return np.asarray(cv2.resize(mean, weight.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
