"""Blending of ellipses front to back in torch, tile by tile: reference of the compiled kernel, and the path on a GPU.

Autograd differentiates it. Any float, so that its gradients can be held against finite differences in double precision.
"""

from collections.abc import Iterator

import torch
from torch.utils.checkpoint import checkpoint

from ggvs_eval.camera import Camera
from ggvs_eval.gaussians.cloud import GaussianCloud
from ggvs_eval.gaussians.projection import LEAST_ALPHA, Ellipses, project

TILE = 16  # pixels, across and down
MOST_ALPHA = 0.99
LEAST_TRANSMITTANCE = 1e-4  # a pixel stops before the Gaussian that would bring it below
MOST_AT_ONCE = 8_000_000  # pairs of pixel and Gaussian, which bounds the memory


def splat(
    cloud: GaussianCloud, camera: Camera, near: float, screen_offsets: torch.Tensor | None
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Render without a background.

    Args:
        near: Gaussians at or before this depth are left out, world units.
        screen_offsets: added to the centres in the image, pixels, (N, 2); or None.

    Returns:
        Sums of colour (H, W, 3) weighted by what each Gaussian covers, transmittance (H, W) to what lies behind all, sums of
        depth (H, W), weighted in the same way, and radii in pixels, (N,) int32.

    Reading:
        A Gaussian ends where its alpha falls below 1/255. The reference cuts it also at the border of the 16-pixel tiles that a
        square of 3 standard deviations touches, so that its picture depends on how the image is cut. Equal depths keep the order
        of the cloud.
    """
    ellipses = project(cloud, camera, near)
    centres = ellipses.centres if screen_offsets is None else ellipses.centres + screen_offsets
    across, down = -(-camera.width // TILE), -(-camera.height // TILE)
    tiles = cloud.means.new_zeros(across * down, TILE * TILE, 5)
    tiles[..., 4] = 1  # transmittance
    with torch.no_grad():
        numbers, starts = _listed(ellipses, across, down)
    shape = torch.cat(
        [centres, ellipses.conics, ellipses.opacities[:, None], ellipses.colours, ellipses.depths[:, None]], -1
    )  # (N, 10)
    chosen, blended = [], []
    for group, lists in _groups(numbers, starts):
        chosen.append(group)
        blended.append(checkpoint(_blend, shape, lists, group, across, use_reentrant=False))
    tiles = tiles + shape[:0].sum()  # gradients are 0, not absent, where nothing is visible
    if chosen:
        tiles = tiles.index_copy(0, torch.cat(chosen), torch.cat(blended))
    picture = tiles.reshape(down, across, TILE, TILE, 5).transpose(1, 2).reshape(down * TILE, across * TILE, 5)
    picture = picture[: camera.height, : camera.width]
    return picture[..., :3], picture[..., 4], picture[..., 3], ellipses.radii


def _listed(ellipses: Ellipses, across: int, down: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Numbers of the Gaussians that each tile lists, nearest first, tile after tile; and where each tile's list starts."""
    order = torch.argsort(ellipses.depths, stable=True)
    order = order[ellipses.visible[order]]
    last = torch.tensor([across - 1, down - 1], device=order.device)
    low = ((ellipses.centres - ellipses.reach)[order] / TILE).clamp_min(0).long()
    high = torch.minimum(((ellipses.centres + ellipses.reach)[order] / TILE).clamp_max(2.0**30).long(), last)
    width = high[:, 0] - low[:, 0] + 1
    counts = width * (high[:, 1] - low[:, 1] + 1)
    pair = torch.repeat_interleave(torch.arange(len(order), device=order.device), counts)
    within = torch.arange(len(pair), device=order.device) - (counts.cumsum(0) - counts)[pair]
    tile = (low[pair, 1] + within // width[pair]) * across + low[pair, 0] + within % width[pair]
    starts = torch.zeros(across * down + 1, dtype=torch.long, device=order.device)
    starts[1:] = torch.bincount(tile, minlength=across * down).cumsum(0)
    return order[pair[torch.argsort(tile, stable=True)]], starts


def _groups(numbers: torch.Tensor, starts: torch.Tensor) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Tiles with lists of like lengths: the tiles' numbers (G,), and their lists (G, M), filled up with -1."""
    lengths = starts.diff()
    order = torch.argsort(lengths, descending=True)
    in_order = lengths[order].tolist()
    first, filled = 0, sum(length > 0 for length in in_order)
    while first < filled:
        longest = in_order[first]
        size = min(max(1, MOST_AT_ONCE // (longest * TILE * TILE)), filled - first)
        while in_order[first + size - 1] < longest // 2:  # much shorter lists wait for their like
            size = max(1, size // 2)
        group = order[first : first + size]
        places = torch.arange(longest, device=numbers.device)
        listed = numbers[(starts[group, None] + places).clamp_max(len(numbers) - 1)]
        yield group, torch.where(places < lengths[group, None], listed, -1)
        first += size


def _blend(shape: torch.Tensor, lists: torch.Tensor, tiles: torch.Tensor, across: int) -> torch.Tensor:
    """Blend the listed Gaussians of some tiles: sums of colour and depth, and transmittance, (G, P, 5)."""
    u, v, xx, xy, yy, opacity, *_ = shape[lists].unbind(-1)  # (G, M) each
    pixel = torch.arange(TILE * TILE, device=shape.device)
    columns = (tiles % across * TILE)[:, None] + pixel % TILE  # (G, P)
    rows = (tiles // across * TILE)[:, None] + pixel // TILE
    dx, dy = columns[:, None] - u[..., None], rows[:, None] - v[..., None]  # (G, M, P)
    quadratic = xx[..., None] * dx * dx + 2 * xy[..., None] * dx * dy + yy[..., None] * dy * dy
    alpha = (opacity[..., None] * torch.exp(-quadratic.clamp_min(0) / 2)).clamp_max(MOST_ALPHA)
    alpha = torch.where((alpha >= LEAST_ALPHA) & (lists >= 0)[..., None], alpha, 0)
    alpha = torch.where(torch.cumprod(1 - alpha.detach(), 1) >= LEAST_TRANSMITTANCE, alpha, 0)
    transmittance = torch.cumprod(1 - alpha, 1)
    weights = alpha * torch.cat([torch.ones_like(alpha[:, :1]), transmittance[:, :-1]], 1)
    sums = torch.einsum("gmp,gmc->gpc", weights, shape[lists][..., 6:])
    return torch.cat([sums, transmittance[:, -1, :, None]], -1)
