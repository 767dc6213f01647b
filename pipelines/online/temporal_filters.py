"""Filters over time: depth of the source cameras (Eq. 2), certainty that nothing moves, and the
previous output.

What changes in all source views alike is motion, what changes in one alone is noise; the previous
output is one more witness of static content, so that noise and flicker average out over time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map, Mask
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.difference_mask import colour_change, mask_of
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat
from ggvs_eval.geometry.warp import Warp, warp, warp_change
from ggvs_eval.kernels import get_threads, side_by_side
from ggvs_eval.method import SourceView

REDUCTION = 4  # stillness is decided at a quarter of the size, as the difference masks are
REACH = 2  # cells: what no view covers moves as its surroundings do
POOL = 2.0  # cells, standard deviation of the window over which the changes of views are compared
LIGHT_PX = 32  # changes as wide as this are light, and are let through
# pairs of views that see a surface, in the mean over the window; with fewer nothing is known
LEAST_LOOKS = 0.05
# energy of the change that views share, times that of what each has for itself: nothing moves, and
# it does
SHARED = (0.3, 0.7)
LARGEST = (12.0, 24.0)  # change next to a cell, times the noise of mean colours: the same
LEAST_NOISE, MOST_NOISE = 0.15 / 255, 1.0 / 255  # of mean colours; below is the rounding to 8 bit
NEVER = np.float32(1e-12)
# energy that a mean of past images errs by, times that of the noise of one: none and all of it
# harms
DRAGGED = (0.3, 0.8)


@dataclass(frozen=True, eq=False)
class Change:
    """Change in a source view since the instant before.

    Attributes:
        before: image of that instant, RGB uint8 (H, W, 3).
        image: image of this one.
        colours: of cells, see `colour_change`.
        mask: M^t, (H, W), see `difference_mask`.
    """

    before: Image8
    image: Image8
    colours: Map
    mask: Map


@dataclass
class TemporalDepthFilter:
    """Recursive filter with one state per camera; its memory does not grow with time.

    Attributes:
        lambda_t: see `difference_mask`.
        beta: see `difference_mask`.
        tolerance: see `filter_depth`.
        enabled: without it every depth passes as it is (ablation 'No Temporal Filtering').
        channels: see `difference_mask`.
    """

    lambda_t: float = 0.7
    beta: float = 0.6
    tolerance: float = 0.05
    enabled: bool = True
    channels: Literal["largest", "mean"] = "largest"
    _history: dict[str, tuple[int, Image8, Map]] = field(default_factory=dict)

    def step(self, index: int, source: SourceView) -> tuple[SourceView, Change | None]:
        """Filter one source view of instant ``index``.

        A camera that was not among the sources at the instant before starts anew: its history is
        stale.

        Returns:
            The view with filtered depth, and what changed in it; None, for it cannot be known,
            where it starts anew.
        """
        history = self._history.get(source.camera.name)
        if (
            not self.enabled
            or history is None
            or history[0] != index - 1
            or history[1].shape != source.image.shape
        ):
            filtered, change = source, None
        else:
            colours, size = colour_change(source.image, history[1]), source.image.shape[:2]
            mask = mask_of(
                colours, size, lambda_t=self.lambda_t, beta=self.beta, channels=self.channels
            )
            change = Change(before=history[1], image=source.image, colours=colours, mask=mask)
            filtered = replace(
                source, depth=filter_depth(source.depth, history[2], change.mask, self.tolerance)
            )
        self._history[source.camera.name] = (index, source.image, filtered.depth)
        return filtered, change


def filter_depth(depth: Map, history: Map, mask: Map, tolerance: float) -> Map:
    """Mix new depth with its history: mask * depth + (1 - mask) * history (Eq. 2).

    Args:
        depth: depth at instant t, (H, W), 0 where unknown.
        history: filtered depth at t - 1, (H, W), 0 where unknown.
        mask: M^t, (H, W), in [0, 1].
        tolerance: depth and history that differ by more than this share of the depth are two
            surfaces; infinity for Eq. 2 as printed.

    Returns:
        Filtered depth, (H, W), float32.

    Reading:
        Where only one of the two is known it is taken alone, history only where the mask does not
        say that everything moved. Eq. 2 as printed also mixes two surfaces where an edge moved over
        like colours, and invents depth between them. Without such mixing a validation room (demo
        seed 101, two views) scored +0.16 dB PSNR, -12 % STED and -20 % SDT.
    """
    from ggvs_eval.kernels import _core

    new, old, weight = (np.ascontiguousarray(array, np.float32) for array in (depth, history, mask))
    return _core.mix_depth(new, old, weight, tolerance, get_threads())


@dataclass(frozen=True, eq=False)
class _Shown:
    """The instant before: its output (H, W, 3), the new image at each cell, and for how many
    instants that has stood still.
    """

    index: int
    target: Camera
    image: Map
    new: Map
    age: Map


class RecurrentOutput:
    """Recursive mean of the outputs of one target, cell by cell, as long as nothing moves there.

    What has stood still for n instants is the mean of as many outputs, until the weight of the past
    reaches its limit. Where something moves the past is forgotten at once. State: one output, one
    image of the cells and one map of ages.

    Args:
        limit: largest weight of the past, below 1; 0 switches it off.

    Raises:
        RenderError: a limit that is no such weight.

    Reading:
        Not in the paper, whose temporal terms smooth depth alone: what the sensors' noise and the
        edges of the fused depth do to the picture passes through them. With geometric weights a
        limit of 0.85 lowers STED from 18.4 to 17.5, 14.3 to 13.7 and 30.3 to 28.7 in three domains
        of a validation room (docs/readings.md) and raises PSNR by 0.01 to 0.03 dB. The limit was
        chosen when stillness was judged by the sources' largest change alone: of 0.25, 0.5, 0.7,
        0.85 and 0.92 it was the best.
    """

    def __init__(self, limit: float) -> None:
        if not 0 <= limit < 1:
            raise RenderError(
                f"recurrent output: the largest weight of the past must be at least 0 and below 1, "
                f"got {limit:g}"
            )
        self._limit = limit
        self._shown: _Shown | None = None

    def step(self, index: int, target: Camera, image: Map, still: Map) -> Map:
        """Return the output of an instant.

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
        if (
            before is not None
            and before.index == index - 1
            and before.target.shows_the_same_rays(target)
        ):
            # instants that a mean of such weights is worth
            most = np.float32((1 + self._limit) / (1 - self._limit))
            past, last, present, is_known = _finite(cells(before.image), before.new, new)
            still = still * agreement(present, past, last, np.minimum(before.age, most)) * is_known
            age += still * before.age
            weight = still * np.minimum(1 - 1 / age, np.float32(self._limit))
            image = mixed(image, before.image, weight, past - present)
        self._shown = _Shown(index=index, target=target, image=image, new=new, age=age)
        return image


def _finite(past: Map, last: Map, new: Map) -> tuple[Map, Map, Map, Mask]:
    """Return three images of cells, black where any of them is not finite, and where all are:
    nothing else has a past.
    """
    is_known = np.isfinite(past + last + new).all(axis=2)
    return *(
        np.where(is_known[..., None], image, np.float32(0)) for image in (past, last, new)
    ), is_known


def agreement(new: Map, mean: Map, last: Map, count: Map) -> Map:
    """Rate how well a mean of past images agrees with the new one, (h, w): 1 if noise alone
    distinguishes them, 0 if it drags.

    Args:
        new: image, (h, w, 3), one pixel of each cell.
        mean: of the images before, what is shown.
        last: the image before alone.
        count: of images in the mean, (h, w).

    Reading:
        Of noise of energy N, new in each image, two images differ by 2 N, and one from the mean of
        n by N (1 + 1 / n), for any N is. What the difference has beyond that is motion that the
        mean drags along, however slow and faint; motion by more than the grain of a texture looks
        like noise here, and is for the sources to see.
    """
    everywhere = np.ones_like(count)

    def energy(change: Map) -> Map:
        return mean_square(change - light(change, everywhere))

    energies = side_by_side(lambda: energy(new - mean), lambda: energy(new - last))
    dragged, doubled = pooled(np.dstack(energies))
    excess = 2 * dragged / np.maximum(doubled, np.float32(2 * LEAST_NOISE**2)) - (1 + 1 / count)
    return falling(excess, *DRAGGED)


def mixed(image: Map, past: Map, weight: Map, change: Map) -> Map:
    """Return the past mixed into an image where it has weight and is finite, except for what
    changed over wide areas.

    Args:
        image: (H, W, 3), float32.
        past: (H, W, 3), float32.
        weight: of the past, one per cell, in [0, 1].
        change: from the image to the past, at each cell, (h, w, 3).

    Reading:
        Light that changes slowly is not seen as motion and would lag behind. The mean difference
        over about 32 pixels, of what is static, is therefore let through.
    """
    from ggvs_eval.kernels import _core

    change = light(change, weight)
    maps = np.stack([weight, *(weight * change[..., channel] for channel in range(3))])
    present, before = (np.ascontiguousarray(array, np.float32) for array in (image, past))
    return _core.recur(present, before, maps, get_threads())


def stillness(
    target: Camera,
    depth: Map,
    views: Sequence[SourceView],
    changes: Sequence[Change],
    largest: Map,
    tolerance: float,
) -> Map:
    """Rate how sure it is that nothing moves at each cell of the target view.

    Args:
        target: camera of the output.
        depth: that it sees, (H, W), world units, 0 where unknown.
        views: the sources that were there at the instant before.
        changes: in each of them.
        largest: change that a source sees at each cell, see `splatted_change`.
        tolerance: depths that differ by less are the same surface, world units.

    Returns:
        (ceil(H / 4), ceil(W / 4)), float32, from 1, nothing moves, to 0: it does, or fewer than two
        views show it.

    Reading:
        Noise is new in every camera, motion is one and the same in all: the mean product of two
        views' changes at a surface that both see is the energy of motion regardless of the noise,
        and what it falls short of the energy of each is the noise, regardless of what moves. No
        threshold is set for a sensor or for a contrast, and a picture that moves as a whole is seen
        to. Both are asked of single pixels, which know the finest texture, and of mean colours of
        cells, in which noise is an eighth. What no two views agree about, uncovered or at a wrong
        depth, is compared with the noise itself.
    """
    small, surface = middle_rays(target), cells(depth)
    still = np.ones_like(surface)
    for looks in (
        _pixels(small, surface, views, changes, tolerance),
        _means(small, surface, views, changes, tolerance),
    ):
        shared, apart, is_known = shared_change(looks)
        still *= falling(shared / np.maximum(apart, np.float32(LEAST_NOISE**2)), *SHARED) * is_known
    if is_known.any():
        noise = np.clip(np.sqrt(max(np.median(apart[is_known]), 0)), LEAST_NOISE, MOST_NOISE)
        still *= falling(largest / np.float32(noise), *LARGEST)
    return still


def _pixels(
    target: Camera,
    depth: Map,
    views: Sequence[SourceView],
    changes: Sequence[Change],
    tolerance: float,
) -> list[Warp]:
    """Return the change of single pixels in each view, where the cells of the target look."""
    return [
        warp_change(target, depth, replace(view, image=change.image), change.before, tolerance)
        for view, change in zip(views, changes, strict=True)
    ]


def _means(
    target: Camera,
    depth: Map,
    views: Sequence[SourceView],
    changes: Sequence[Change],
    tolerance: float,
) -> list[Warp]:
    """Return the change of mean colours in each view, where the cells of the target look."""
    warps = []
    for view, change in zip(views, changes, strict=True):
        height, width = change.colours.shape[:2]
        small, depths = view.camera.resized(width, height), cells(view.depth, (height, width))
        warps.append(warp(target, depth, small, change.colours, depths, tolerance))
    return warps


def shared_change(views: Sequence[Warp]) -> tuple[Map, Map, Map]:
    """Separate the change that views share from that of each alone.

    Args:
        views: change of colour in each and how far it sees the surface, at the same cells.

    Returns:
        Energy per channel of both, (h, w), and where enough pairs of views look.
    """
    size = views[0].visibility.shape
    total, (energy, looks, squares) = (
        np.zeros((*size, 3), np.float32),
        np.zeros((3, *size), np.float32),
    )
    for view in views:
        weighted = view.visibility[..., None] * (view.colour - light(view.colour, view.visibility))
        total += weighted
        energy += mean_square(weighted)
        looks += view.visibility
        squares += view.visibility**2
    # The first two are of all pairs, each twice.
    sums = np.dstack([mean_square(total) - energy, looks**2 - squares, energy, squares])
    products, pairs, energy, squares = pooled(sums)
    shared = products / np.maximum(pairs, NEVER)
    return shared, energy / np.maximum(squares, NEVER) - shared, pairs > 2 * LEAST_LOOKS


def splatted_change(splats: Sequence[Splat], beta_mask: float, lambda_t: float) -> Map:
    """Return the largest change of colour that a source sees at each cell and next to it: Eq. 1
    undone, in the target view.

    Args:
        splats: forward renderings, at least one, whose fourth feature is the difference mask.
        beta_mask: as in `difference_mask`.
        lambda_t: as in `difference_mask`.

    Returns:
        Absolute difference of colours, (ceil(H / 4), ceil(W / 4)), 0 if neither a cell nor its
        neighbours are covered.
    """
    mask = np.zeros_like(cells(splats[0].alpha))
    for view in splats:
        np.maximum(
            mask, cells(view.features[..., 3]), out=mask, where=cells(view.alpha) >= COVERED_ALPHA
        )
    size = 2 * REACH + 1
    widest = cv2.dilate(mask, np.ones((size, size), np.uint8))
    return np.asarray(
        np.maximum(widest - np.float32(beta_mask), 0) * np.float32(lambda_t), np.float32
    )


def cells(image: Map, size: tuple[int, int] | None = None) -> Map:
    """Return the pixel in the middle of each cell of an image (H, W, ...), a copy.

    Args:
        image: at full size.
        size: rows and columns of cells; a quarter of the image's, rounded up, unless given.

    Examples:
        >>> cells(np.arange(10)[None]).tolist()
        [[1, 5, 8]]
    """
    size = size or tuple(-(-side // REDUCTION) for side in image.shape[:2])
    rows, columns = (
        middles(side, count) for side, count in zip(image.shape[:2], size, strict=True)
    )
    return image[rows].take(columns, axis=1)


def middle_rays(camera: Camera) -> Camera:
    """Return the camera whose pixels show what `cells` takes of another one's image: the middles of
    pixels, not of cells.
    """
    height, width = (-(-side // REDUCTION) for side in (camera.height, camera.width))
    small = camera.resized(width, height)
    offset = [0.5 * width / camera.width, 0.5 * height / camera.height]
    return replace(small, K=small.K - np.array([[0, 0, offset[0]], [0, 0, offset[1]], [0, 0, 0]]))


def middles(side: int, count: int) -> NDArray[np.int64]:
    """Return the number of the pixel in the middle of each of N cells of a line."""
    return ((2 * np.arange(count, dtype=np.int64) + 1) * side) // (2 * count)


def light(change: Map, weight: Map) -> Map:
    """Return the mean of a change of colour per cell, (h, w, 3), over areas as wide as light, by
    weights (h, w).
    """
    block = LIGHT_PX // REDUCTION
    small = (-(-weight.shape[1] // block), -(-weight.shape[0] // block))
    parts = cv2.merge([*(change[..., channel] * weight for channel in range(3)), weight])
    sums = cv2.GaussianBlur(cv2.resize(parts, small, interpolation=cv2.INTER_AREA), (0, 0), 1)
    mean = sums[..., :3] / (sums[..., 3:] + np.float32(1e-3))
    return np.asarray(
        cv2.resize(mean, weight.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32
    )


def mean_square(change: Map) -> Map:
    """Return the energy of a change of colour, (h, w, 3), per channel."""
    # numpy sums so short an axis five times as slowly
    red, green, blue = np.moveaxis(change * change, -1, 0)
    return np.asarray((red + green + blue) / np.float32(3), np.float32)


def pooled(maps: Map) -> Map:
    """Return the means over the window of `POOL` cells of maps (h, w, n), as (n, h, w)."""
    return np.moveaxis(cv2.GaussianBlur(maps, (0, 0), POOL), -1, 0)


def falling(value: NDArray[np.floating], first: float, last: float) -> Map:
    """1 up to the first value, 0 from the last one on, a line between them."""
    return np.clip((np.float32(last) - value) / np.float32(last - first), 0, 1).astype(np.float32)
