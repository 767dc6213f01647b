"""Points with features seen by a camera, each as a small disc that fades to its rim (after Wiles et al. 2020, SynSin)."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ggvs_eval.camera import Camera

RADIUS_PX = 1.5
TINY = 1e-12  # square pixels; the root has a slope there
POINTS_PER_PIXEL = 24  # the nearest of those whose disc covers the pixel; the published code takes 16 where it learns depth


@dataclass(frozen=True, eq=False)
class PointSplat:
    """What the points look like.

    Attributes:
        features: premultiplied by coverage, (C, H, W).
        alpha: coverage, (H, W), in [0, 1].
    """

    features: Tensor
    alpha: Tensor


def splat_points(
    points: Tensor, features: Tensor, target: Camera, near: float, radius_px: float = RADIUS_PX, count: int = POINTS_PER_PIXEL
) -> PointSplat:
    """Render points front to back.

    A point at distance d < r from a pixel's centre covers it by 1 - sqrt(d^2 / r^2); of those that do, the `count` nearest to the
    camera are blended, equal depths in the order of the points.

    Args:
        points: in the target camera, (N, 3), float64, world units.
        features: (N, C), float32.
        target: the camera to render.
        near: points at or before this depth are left out, world units.
        radius_px: r, pixels.
        count: most points per pixel.
    """
    pixels, members, alphas = _pairs(points, target, near, radius_px)
    size = target.height * target.width
    counts = torch.bincount(pixels, minlength=size)
    starts = counts.cumsum(0) - counts
    blended, light = torch.zeros(size, features.shape[1]), torch.ones(size)
    for rank in range(min(count, int(counts.max()))):
        covered = torch.nonzero(counts > rank)[:, 0]
        pair = starts[covered] + rank
        weight = light[covered] * alphas[pair]
        blended[covered] += weight[:, None] * features[members[pair]]
        light[covered] *= 1 - alphas[pair]
    shape = (target.height, target.width)
    return PointSplat(blended.T.reshape(-1, *shape), (1 - light).view(shape))


def _pairs(points: Tensor, target: Camera, near: float, radius_px: float) -> tuple[Tensor, Tensor, Tensor]:
    """Every pixel that a point covers, by pixel and nearest point first: flat pixel, index of the point, alpha; (M,) each."""
    seen = torch.nonzero(points[:, 2] > near)[:, 0]
    seen = seen[torch.sort(points[seen, 2], stable=True).indices]
    x, y, z = points[seen].unbind(dim=1)
    centres = torch.stack([x / z * target.K[0, 0] + target.K[0, 2], y / z * target.K[1, 1] + target.K[1, 2]], dim=1) - 0.5
    steps = torch.arange(math.ceil(2 * radius_px))
    places = torch.ceil(centres - radius_px)[:, :, None] + steps  # (N, 2, n)
    columns, rows = places[:, 0, None, :], places[:, 1, :, None]
    square = (columns - centres[:, 0, None, None]) ** 2 + (rows - centres[:, 1, None, None]) ** 2  # (N, n, n)
    covered = (columns >= 0) & (columns < target.width) & (rows >= 0) & (rows < target.height) & (square < radius_px**2)
    owner = torch.nonzero(covered)[:, 0]  # by point, so still nearest first
    pixels = (rows * target.width + columns)[covered].long()
    alphas = (1 - torch.sqrt(square[covered].clamp(min=TINY)) / radius_px).float()
    order = torch.sort(pixels, stable=True).indices
    return pixels[order], seen[owner[order]], alphas[order]
