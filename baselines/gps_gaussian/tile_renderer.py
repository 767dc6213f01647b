"""Renders anisotropic Gaussians tile by tile, front to back, as 3D Gaussian splatting does (Kerbl et al. 2023)."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.baselines.gps_gaussian.gaussians import TILE, Footprints, Gaussians, footprints
from ggvs_eval.baselines.gps_gaussian.tile_batches import MAX_ALPHA, MIN_ALPHA, MIN_LIGHT, NEGLIGIBLE, blend_batches
from ggvs_eval.camera import Camera

CHUNK = 256  # Gaussians of a tile that are evaluated at once


class GaussianImage(NamedTuple):
    """What the Gaussians look like before black.

    Attributes:
        colour: premultiplied by coverage, (H, W, 3), float32.
        alpha: coverage, (H, W), float32.
        depth: mean depth of what covers the pixel, (H, W), world units, 0 where nothing does.
    """

    colour: Map
    alpha: Map
    depth: Map


def render_gaussians(gaussians: Gaussians, target: Camera, near: float) -> GaussianImage:
    """Render Gaussians of any shape in one pass; arguments as of `blend_gaussians`."""
    image = blend_gaussians(gaussians, target, near).numpy(force=True)
    alpha = image[..., 4]
    depth = np.divide(image[..., 3], alpha, out=np.zeros_like(alpha), where=alpha > MIN_ALPHA)
    return GaussianImage(np.ascontiguousarray(image[..., :3]), np.ascontiguousarray(alpha), depth)


def blend_gaussians(gaussians: Gaussians, target: Camera, near: float) -> Tensor:
    """Colour, depth and coverage, each the sum over Gaussians of its value times alpha times the light left for it.

    Args:
        gaussians: what is seen; gradients reach all of it.
        target: the camera to render.
        near: Gaussians at or before this depth are left out, world units.

    Returns:
        (H, W, 5): red, green, blue, depth, coverage.

    Reading:
        As the reference rasteriser: a Gaussian counts only in tiles of 16 x 16 pixels that the square of three standard
        deviations around it touches, an alpha is at most 0.99 and ignored below 1/255, and a pixel is done before the Gaussian
        that would leave less than 1e-4 of its light. Principal points need not be central.
    """
    seen = footprints(gaussians, target, near)
    columns, rows = -(-target.width // TILE), -(-target.height // TILE)
    members, starts = _tiles(seen, columns, rows)
    features = torch.cat([seen.colours, seen.depths[:, None], torch.ones_like(seen.depths)[:, None]], dim=1)  # (N, 5)
    if features.device.type == "cuda":
        canvas = blend_batches(seen, features, members, starts, columns).view(rows, columns, TILE, TILE, -1)
    else:
        canvas = torch.zeros(rows, columns, TILE, TILE, features.shape[1])
        for tile, (first, last) in enumerate(pairwise(starts.tolist())):
            if first < last:
                row, column = divmod(tile, columns)
                canvas[row, column] = _blend(seen, features, members[first:last], column * TILE, row * TILE)
    image = canvas.permute(0, 2, 1, 3, 4).reshape(rows * TILE, columns * TILE, -1)
    return image[: target.height, : target.width]


def _tiles(seen: Footprints, columns: int, rows: int) -> tuple[Tensor, Tensor]:
    """Indices of the Gaussians of each tile, nearest first, (M,), and where each tile's begin, (columns * rows + 1,)."""
    most = torch.tensor([columns, rows])
    low = torch.floor((seen.centres - seen.radii[:, None]) / TILE).clamp(min=0).long().minimum(most)  # (N, 2)
    high = torch.floor((seen.centres + seen.radii[:, None] + TILE - 1) / TILE).clamp(min=0).long().minimum(most)
    spans = (high - low).clamp(min=0)
    counts = spans[:, 0] * spans[:, 1]
    members = torch.repeat_interleave(torch.arange(len(counts)), counts)  # (M,), still nearest first
    within = torch.arange(len(members)) - torch.repeat_interleave(counts.cumsum(0) - counts, counts)
    width = spans[members, 0]
    tiles = (low[members, 1] + within // width) * columns + low[members, 0] + within % width
    order = torch.sort(tiles, stable=True).indices
    starts = torch.zeros(columns * rows + 1, dtype=torch.long)
    starts[1:] = torch.bincount(tiles, minlength=columns * rows).cumsum(0)
    return members[order], starts


def _blend(seen: Footprints, features: Tensor, members: Tensor, left: int, top: int) -> Tensor:
    """Features of one tile, (TILE, TILE, C), its Gaussians blended front to back."""
    light = torch.ones(TILE * TILE)
    blended = torch.zeros(TILE * TILE, features.shape[1])
    for chunk in members.split(CHUNK):
        alpha = _alphas(seen, chunk, left, top)  # (TILE**2, n)
        after = light[:, None] * torch.cumprod(1 - alpha, dim=1)
        before = torch.cat([light[:, None], after[:, :-1]], dim=1)
        weights = torch.where(after >= MIN_LIGHT, alpha * before, torch.zeros(()))  # once dark, a pixel stays dark
        blended += weights @ features[chunk]
        light = after[:, -1]
        if not bool((light >= MIN_LIGHT).any()):
            break
    return blended.view(TILE, TILE, -1)


def _alphas(seen: Footprints, chunk: Tensor, left: int, top: int) -> Tensor:
    """Alpha of some Gaussians at each pixel of a tile, (TILE**2, n)."""
    centres, conics = seen.centres[chunk], seen.conics[chunk]
    steps = torch.arange(TILE, dtype=torch.float32)[:, None]
    across, down = left + steps - centres[:, 0], top + steps - centres[:, 1]  # (TILE, n) each
    power = (-0.5 * conics[:, 0] * across**2)[None] + (-0.5 * conics[:, 2] * down**2)[:, None]  # (rows, columns, n)
    power = power - (conics[:, 1] * across)[None] * down[:, None]
    wrong = power > 0  # by rounding alone
    alpha = (torch.exp(power.clamp(min=NEGLIGIBLE)) * seen.opacities[chunk]).clamp(max=MAX_ALPHA)
    return alpha.masked_fill(wrong | (alpha < MIN_ALPHA), 0).view(TILE * TILE, -1)
