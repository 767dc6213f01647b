"""Blends the Gaussians of all tiles side by side: many small pieces of work, one tile each, would leave a GPU idle."""

import torch
from torch import Tensor

from ggvs_eval.baselines.gps_gaussian.gaussians import TILE, Footprints

MAX_ALPHA, MIN_ALPHA, MIN_LIGHT = 0.99, 1 / 255, 1e-4
NEGLIGIBLE = -6.0  # an exponent that stays below MIN_ALPHA; far smaller ones give denormal numbers, which are slow
RANKS_AT_ONCE, TILES_AT_ONCE = 64, 2048  # Gaussians of a tile, and tiles: some 1 GB


def blend_batches(seen: Footprints, features: Tensor, members: Tensor, starts: Tensor, columns: int) -> Tensor:
    """Features of every tile, its Gaussians blended front to back: the nearest of all tiles first, then the next ones.

    Args:
        seen: Gaussians on the image.
        features: of each, (N, C).
        members: indices of the Gaussians of each tile, nearest first, (M,).
        starts: where each tile's begin, (T + 1,), tiles row by row.
        columns: tiles in a row.

    Returns:
        (T, TILE, TILE, C).
    """
    counts = starts[1:] - starts[:-1]
    light = torch.ones(len(counts), TILE * TILE)
    blended = torch.zeros(len(counts), TILE * TILE, features.shape[1])
    for first in range(0, int(counts.max()), RANKS_AT_ONCE):
        lit = torch.nonzero((counts > first) & (light >= MIN_LIGHT).any(dim=1))[:, 0]
        if not len(lit):
            break
        ranks = first + torch.arange(RANKS_AT_ONCE)
        for tiles in lit.split(TILES_AT_ONCE):
            there = ranks < counts[tiles, None]  # (t, n)
            chunk = members[torch.where(there, starts[tiles, None] + ranks, 0)]
            alpha = _alphas(seen, chunk, tiles % columns * TILE, tiles // columns * TILE) * there[:, None]  # (t, TILE**2, n)
            before = light[tiles, :, None]
            after = before * torch.cumprod(1 - alpha, dim=2)
            before = torch.cat([before, after[..., :-1]], dim=2)
            weights = torch.where(after >= MIN_LIGHT, alpha * before, 0.0)  # once dark, a pixel stays dark
            blended[tiles] += weights @ features[chunk]
            light[tiles] = after[..., -1]
    return blended.view(len(counts), TILE, TILE, -1)


def _alphas(seen: Footprints, chunk: Tensor, left: Tensor, top: Tensor) -> Tensor:
    """Alpha of Gaussians (t, n) at each pixel of their tiles, (t, TILE**2, n); tiles begin at pixels left, top, (t,)."""
    centres, conics = seen.centres[chunk], seen.conics[chunk, None]  # (t, n, 2), (t, n, 1, 3)
    xx, xy, yy = conics.transpose(1, 2).unbind(dim=-1)  # (t, 1, n) each
    steps = torch.arange(TILE)
    across = (left[:, None] + steps)[..., None] - centres[:, None, :, 0]  # (t, TILE, n)
    down = (top[:, None] + steps)[..., None] - centres[:, None, :, 1]
    power = (-0.5 * xx * across**2)[:, None] + (-0.5 * yy * down**2)[:, :, None]  # (t, rows, columns, n)
    power = power - (xy * across)[:, None] * down[:, :, None]
    alpha = (torch.exp(power.clamp(min=NEGLIGIBLE)) * seen.opacities[chunk][:, None, None]).clamp(max=MAX_ALPHA)
    return alpha.masked_fill((power > 0) | (alpha < MIN_ALPHA), 0).flatten(1, 2)  # above 0 by rounding alone
