"""Certainty that nothing moves: what changes in all source views alike is motion, what changes in one alone is noise."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat
from ggvs_eval.geometry.warp import Warp, warp, warp_change
from ggvs_eval.method import SourceView
from ggvs_eval.pipelines.online.depth_filter import Change

REDUCTION = 4  # stillness is decided at a quarter of the size, as the difference masks are
REACH = 2  # cells: what no view covers moves as its surroundings do
POOL = 2.0  # cells, standard deviation of the window over which the changes of views are compared
LIGHT_PX = 32  # changes as wide as this are light, and are let through
LEAST_LOOKS = 0.05  # pairs of views that see a surface, in the mean over the window; with fewer nothing is known
SHARED = (0.3, 0.7)  # energy of the change that views share, times that of what each has for itself: nothing moves, and it does
LARGEST = (12.0, 24.0)  # change next to a cell, times the noise of mean colours: the same
LEAST_NOISE, MOST_NOISE = 0.15 / 255, 1.0 / 255  # of mean colours; below lies the rounding to 8 bit
NEVER = np.float32(1e-12)


def stillness(
    target: Camera, depth: Map, views: Sequence[SourceView], changes: Sequence[Change], largest: Map, tolerance: float
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
        (ceil(H / 4), ceil(W / 4)), float32, from 1, nothing moves, to 0: it does, or fewer than two views can tell.

    Reading:
        Noise is new in every camera, motion is one and the same in all: the mean product of two views' changes at a surface that
        both see is the energy of motion whatever the noise is, and what it falls short of the energy of each is the noise,
        whatever moves. No threshold is set for a sensor or for a contrast, and a picture that moves as a whole is seen to. Both
        are asked of single pixels, which know the finest texture, and of mean colours of cells, in which noise is an eighth.
        What no two views agree about, uncovered or at a wrong depth, is held against the noise itself.
    """
    small, surface = middle_rays(target), cells(depth)
    still = np.ones_like(surface)
    for seen in (_pixels(small, surface, views, changes, tolerance), _means(small, surface, views, changes, tolerance)):
        shared, apart, known = shared_change(seen)
        still *= falling(shared / np.maximum(apart, np.float32(LEAST_NOISE**2)), *SHARED) * known
    if known.any():
        noise = np.clip(np.sqrt(max(np.median(apart[known]), 0)), LEAST_NOISE, MOST_NOISE)
        still *= falling(largest / np.float32(noise), *LARGEST)
    return still


def _pixels(target: Camera, depth: Map, views: Sequence[SourceView], changes: Sequence[Change], tolerance: float) -> list[Warp]:
    """Change of single pixels in each view, where the cells of the target look."""
    return [
        warp_change(target, depth, replace(view, image=change.now), change.before, tolerance)
        for view, change in zip(views, changes, strict=True)
    ]


def _means(target: Camera, depth: Map, views: Sequence[SourceView], changes: Sequence[Change], tolerance: float) -> list[Warp]:
    """Change of mean colours in each view, where the cells of the target look."""
    found = []
    for view, change in zip(views, changes, strict=True):
        height, width = change.colours.shape[:2]
        small, depths = view.camera.resized(width, height), cells(view.depth, (height, width))
        found.append(warp(target, depth, small, change.colours, depths, tolerance))
    return found


def shared_change(views: Sequence[Warp]) -> tuple[Map, Map, Map]:
    """Tell the change that views share from what each has for itself.

    Args:
        views: change of colour in each and how far it sees the surface, at the same cells.

    Returns:
        Energy per channel of both, (h, w), and where enough pairs of views look.
    """
    size = views[0].visibility.shape
    total, (energy, looks, own) = np.zeros((*size, 3), np.float32), np.zeros((3, *size), np.float32)
    for seen in views:
        weighted = seen.visibility[..., None] * (seen.colour - light(seen.colour, seen.visibility))
        total += weighted
        energy += mean_square(weighted)
        looks += seen.visibility
        own += seen.visibility**2
    sums = np.dstack([mean_square(total) - energy, looks**2 - own, energy, own])  # the first two: of all pairs, each twice
    products, pairs, energy, own = pooled(sums)
    shared = products / np.maximum(pairs, NEVER)
    return shared, energy / np.maximum(own, NEVER) - shared, pairs > 2 * LEAST_LOOKS


def splatted_change(splats: Sequence[Splat], beta_mask: float, lambda_t: float) -> Map:
    """The largest change of colour that a source sees at each cell and next to it: Eq. 1 undone, in the target view.

    Args:
        splats: forward renderings, at least one, whose fourth feature is the difference mask.
        beta_mask: as in `difference_mask`.
        lambda_t: as in `difference_mask`.

    Returns:
        Absolute difference of colours, (ceil(H / 4), ceil(W / 4)), 0 where neither a cell nor its neighbours are covered.
    """
    mask = np.zeros_like(cells(splats[0].alpha))
    for view in splats:
        np.maximum(mask, cells(view.features[..., 3]), out=mask, where=cells(view.alpha) >= COVERED_ALPHA)
    size = 2 * REACH + 1
    widest = cv2.dilate(mask, np.ones((size, size), np.uint8))
    return np.asarray(np.maximum(widest - np.float32(beta_mask), 0) * np.float32(lambda_t), np.float32)


def cells(image: Map, size: tuple[int, int] | None = None) -> Map:
    """The pixel in the middle of each cell of an image (H, W, ...), a copy.

    Args:
        image: at full size.
        size: rows and columns of cells; a quarter of the image's, rounded up, unless given.

    Examples:
        >>> cells(np.arange(10)[None]).tolist()
        [[1, 5, 8]]
    """
    size = size or tuple(-(-side // REDUCTION) for side in image.shape[:2])
    rows, columns = (middles(side, count) for side, count in zip(image.shape[:2], size, strict=True))
    return image[rows].take(columns, axis=1)


def middle_rays(camera: Camera) -> Camera:
    """The camera whose pixels show what `cells` takes of another one's image: the middles of pixels, not of cells."""
    height, width = (-(-side // REDUCTION) for side in (camera.height, camera.width))
    small = camera.resized(width, height)
    offset = [0.5 * width / camera.width, 0.5 * height / camera.height]
    return replace(small, K=small.K - np.array([[0, 0, offset[0]], [0, 0, offset[1]], [0, 0, 0]]))


def middles(side: int, count: int) -> NDArray[np.int64]:
    """Number of the pixel in the middle of each of so many cells of a line."""
    return ((2 * np.arange(count, dtype=np.int64) + 1) * side) // (2 * count)


def light(change: Map, weight: Map) -> Map:
    """Mean of a change of colour per cell, (h, w, 3), over areas as wide as light, by weights (h, w)."""
    block = LIGHT_PX // REDUCTION
    small = (-(-weight.shape[1] // block), -(-weight.shape[0] // block))
    parts = cv2.merge([*(change[..., channel] * weight for channel in range(3)), weight])
    sums = cv2.GaussianBlur(cv2.resize(parts, small, interpolation=cv2.INTER_AREA), (0, 0), 1)
    mean = sums[..., :3] / (sums[..., 3:] + np.float32(1e-3))
    return np.asarray(cv2.resize(mean, weight.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def mean_square(change: Map) -> Map:
    """Energy of a change of colour, (h, w, 3), per channel."""
    red, green, blue = np.moveaxis(change * change, -1, 0)  # numpy sums so short an axis five times as slowly
    return np.asarray((red + green + blue) / np.float32(3), np.float32)


def pooled(maps: Map) -> Map:
    """Means over the window of `POOL` cells of maps (h, w, n), as (n, h, w)."""
    return np.moveaxis(cv2.GaussianBlur(maps, (0, 0), POOL), -1, 0)


def falling(value: NDArray[np.floating], first: float, last: float) -> Map:
    """1 up to the first value, 0 from the last one on, a line between them."""
    return np.clip((np.float32(last) - value) / np.float32(last - first), 0, 1).astype(np.float32)
