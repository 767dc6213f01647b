"""Renders anisotropic Gaussians tile by tile, front to back, as 3D Gaussian splatting does (Kerbl
et al. 2023).

What a camera sees of each one is EWA splatting (Zwicker et al. 2001).
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera

BLUR_PX2 = 0.3  # added to the variance on the image, so that no Gaussian falls between the pixels
EDGE = 1.3  # beyond this share of the half field of view the projection is linearised at that edge
SIGMAS = 3  # how far a Gaussian reaches
# pixels along each side of a tile; a Gaussian is evaluated in every tile that the square around it
# touches
TILE = 16
CHUNK = 256  # Gaussians of a tile that are evaluated at once
MAX_ALPHA, MIN_ALPHA, MIN_LIGHT = 0.99, 1 / 255, 1e-4
# an exponent that stays below MIN_ALPHA; far smaller ones give denormal numbers, which are slow
NEGLIGIBLE = -6.0
RANKS_AT_ONCE, TILES_AT_ONCE = 64, 2048  # Gaussians of a tile, and tiles: some 1 GB


@dataclass(frozen=True, eq=False)
class Gaussians:
    """Gaussians of any shape.

    Attributes:
        centres: in the world, (N, 3), float64.
        axes: columns are their main axes in the world, (N, 3, 3), float32.
        scales: standard deviations along them, world units, (N, 3), float32.
        opacities: (N,), float32, in [0, 1].
        colours: (N, 3), float32.
    """

    centres: Tensor
    axes: Tensor
    scales: Tensor
    opacities: Tensor
    colours: Tensor


@dataclass(frozen=True, eq=False)
class Footprints:
    """Gaussians on the image, nearest first.

    Attributes:
        centres: array indices of columns and rows (pixel centres at integers), (N, 2).
        conics: inverse covariance as its entries xx, xy, yy, (N, 3), per square pixel.
        radii: how far they reach, whole pixels, (N,).
        depths: (N,), world units.
        opacities: (N,).
        colours: (N, 3).
    """

    centres: Tensor
    conics: Tensor
    radii: Tensor
    depths: Tensor
    opacities: Tensor
    colours: Tensor


def join(parts: list[Gaussians]) -> Gaussians:
    """Return all Gaussians of several sets."""
    return Gaussians(
        *(
            torch.cat([getattr(part, name) for part in parts])
            for name in Gaussians.__dataclass_fields__
        )
    )


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """Return the rotation matrices (N, 3, 3) of unit quaternions w, x, y, z, (N, 4)."""
    w, x, y, z = quaternions.unbind(dim=1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1),
    ]
    return torch.stack(rows, dim=1)


def footprints(gaussians: Gaussians, target: Camera, near: float) -> Footprints:
    """Project Gaussians; those at or before `near` and those that reach no tile are left out.

    Equal depths stay in the order of the Gaussians.
    """
    rotation = torch.as_tensor(np.array(target.rotation))
    # (N, 3)
    points = gaussians.centres @ rotation.T + torch.as_tensor(np.array(target.translation))
    indices = torch.nonzero(points[:, 2] > near)[:, 0]
    points = points[indices]
    focal, middle = (
        torch.as_tensor(np.array(values)) for values in (target.K[[0, 1], [0, 1]], target.K[:2, 2])
    )
    centres = (points[:, :2] / points[:, 2:] * focal + middle - 0.5).float()
    covariance = _image_covariance(
        points.float(), gaussians.axes[indices], gaussians.scales[indices], target
    )
    conics, radii = _conics(covariance)
    reach = (centres + radii[:, None] >= 0) & (
        centres - radii[:, None] < torch.tensor(target.size) + TILE
    )
    rows = torch.nonzero(reach.all(dim=1) & (radii > 0))[:, 0]
    depths, order = torch.sort(points[rows, 2].float(), stable=True)
    rows = rows[order]
    return Footprints(
        centres=centres[rows],
        conics=conics[rows],
        radii=radii[rows],
        depths=depths,
        opacities=gaussians.opacities[indices[rows]],
        colours=gaussians.colours[indices[rows]],
    )


def _image_covariance(points: Tensor, axes: Tensor, scales: Tensor, target: Camera) -> Tensor:
    """Return the covariance on the image, entries xx, xy, yy, (N, 3): J W Sigma W^T J^T + blur, J
    the projection linearised.
    """
    fx, fy = float(target.K[0, 0]), float(target.K[1, 1])
    limit = EDGE * torch.tensor([target.width / (2 * fx), target.height / (2 * fy)])
    z = points[:, 2]
    x, y = (points[:, :2] / points[:, 2:]).clamp(-limit, limit).unbind(dim=1)
    # (N, 3, 3), columns are sigmas
    turned = torch.as_tensor(np.array(target.rotation)).float() @ (axes * scales[:, None])
    # (N, 3), first row of J W R S
    across = (turned[:, 0] - x[:, None] * turned[:, 2]) * (fx / z)[:, None]
    down = (turned[:, 1] - y[:, None] * turned[:, 2]) * (fy / z)[:, None]
    return torch.stack(
        [(across**2).sum(1) + BLUR_PX2, (across * down).sum(1), (down**2).sum(1) + BLUR_PX2], dim=1
    )


def _conics(covariance: Tensor) -> tuple[Tensor, Tensor]:
    """Return the inverse of a covariance (N, 3), and `SIGMAS` standard deviations along its longer
    axis in whole pixels (N,).
    """
    xx, xy, yy = covariance.unbind(dim=1)
    determinant = xx * yy - xy * xy
    half_trace = (xx + yy) / 2
    largest = half_trace + torch.sqrt((half_trace**2 - determinant).clamp(min=0.1))
    radii = torch.where(
        determinant > 0, torch.ceil(SIGMAS * torch.sqrt(largest)), torch.zeros_like(xx)
    )
    conics = torch.stack([yy, -xy, xx], dim=1) / determinant[:, None]
    return conics, radii


class GaussianImage(NamedTuple):
    """Rendered Gaussians, before they are composited over black.

    Attributes:
        colour: premultiplied by coverage, (H, W, 3), float32.
        alpha: coverage, (H, W), float32.
        depth: mean depth of what covers the pixel, (H, W), world units, 0 if nothing does.
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
    """Return the colour, depth and coverage, each the sum over Gaussians of its value times alpha
    times the light left for it.

    Args:
        gaussians: what is seen; gradients reach all of it.
        near: Gaussians at or before this depth are left out, world units.

    Returns:
        (H, W, 5): red, green, blue, depth, coverage.

    Reading:
        As the reference rasteriser: a Gaussian counts only in tiles of 16 x 16 pixels that the
        square of three standard deviations around it touches, an alpha is at most 0.99 and ignored
        below 1/255, and a pixel is done before the Gaussian that would leave less than 1e-4 of its
        light. Principal points need not be central.
    """
    splats = footprints(gaussians, target, near)
    columns, rows = -(-target.width // TILE), -(-target.height // TILE)
    members, starts = _tiles(splats, columns, rows)
    # (N, 5)
    features = torch.cat(
        [splats.colours, splats.depths[:, None], torch.ones_like(splats.depths)[:, None]], dim=1
    )
    if features.device.type == "cuda":
        canvas = blend_batches(splats, features, members, starts, columns).view(
            rows, columns, TILE, TILE, -1
        )
    else:
        canvas = torch.zeros(rows, columns, TILE, TILE, features.shape[1])
        for tile, (first, last) in enumerate(pairwise(starts.tolist())):
            if first < last:
                row, column = divmod(tile, columns)
                canvas[row, column] = _blend_tile(
                    splats, features, members[first:last], column * TILE, row * TILE
                )
    image = canvas.permute(0, 2, 1, 3, 4).reshape(rows * TILE, columns * TILE, -1)
    return image[: target.height, : target.width]


def _tiles(splats: Footprints, columns: int, rows: int) -> tuple[Tensor, Tensor]:
    """Indices of the Gaussians of each tile, nearest first, (M,), and where each tile's begin,
    (columns * rows + 1,).
    """
    most = torch.tensor([columns, rows])
    # (N, 2)
    low = (
        torch.floor((splats.centres - splats.radii[:, None]) / TILE)
        .clamp(min=0)
        .long()
        .minimum(most)
    )
    high = (
        torch.floor((splats.centres + splats.radii[:, None] + TILE - 1) / TILE)
        .clamp(min=0)
        .long()
        .minimum(most)
    )
    spans = (high - low).clamp(min=0)
    counts = spans[:, 0] * spans[:, 1]
    # (M,), still nearest first
    members = torch.repeat_interleave(torch.arange(len(counts)), counts)
    within = torch.arange(len(members)) - torch.repeat_interleave(counts.cumsum(0) - counts, counts)
    width = spans[members, 0]
    tiles = (low[members, 1] + within // width) * columns + low[members, 0] + within % width
    order = torch.sort(tiles, stable=True).indices
    starts = torch.zeros(columns * rows + 1, dtype=torch.long)
    starts[1:] = torch.bincount(tiles, minlength=columns * rows).cumsum(0)
    return members[order], starts


def _blend_tile(
    splats: Footprints, features: Tensor, members: Tensor, left: int, top: int
) -> Tensor:
    """Return the features of one tile, (TILE, TILE, C), its Gaussians blended front to back."""
    light = torch.ones(TILE * TILE)
    blended = torch.zeros(TILE * TILE, features.shape[1])
    for chunk in members.split(CHUNK):
        alpha = _tile_alphas(splats, chunk, left, top)  # (TILE**2, n)
        after = light[:, None] * torch.cumprod(1 - alpha, dim=1)
        before = torch.cat([light[:, None], after[:, :-1]], dim=1)
        # once dark, a pixel stays dark
        weights = torch.where(after >= MIN_LIGHT, alpha * before, torch.zeros(()))
        blended += weights @ features[chunk]
        light = after[:, -1]
        if not bool((light >= MIN_LIGHT).any()):
            break
    return blended.view(TILE, TILE, -1)


def _tile_alphas(splats: Footprints, chunk: Tensor, left: int, top: int) -> Tensor:
    """Return the alpha of some Gaussians at each pixel of a tile, (TILE**2, n)."""
    centres, conics = splats.centres[chunk], splats.conics[chunk]
    steps = torch.arange(TILE, dtype=torch.float32)[:, None]
    across, down = left + steps - centres[:, 0], top + steps - centres[:, 1]  # (TILE, n) each
    # (rows, columns, n)
    power = (-0.5 * conics[:, 0] * across**2)[None] + (-0.5 * conics[:, 2] * down**2)[:, None]
    power = power - (conics[:, 1] * across)[None] * down[:, None]
    wrong = power > 0  # by rounding alone
    alpha = (torch.exp(power.clamp(min=NEGLIGIBLE)) * splats.opacities[chunk]).clamp(max=MAX_ALPHA)
    return alpha.masked_fill(wrong | (alpha < MIN_ALPHA), 0).view(TILE * TILE, -1)


def blend_batches(
    footprints: Footprints, features: Tensor, members: Tensor, starts: Tensor, columns: int
) -> Tensor:
    """Return the features of every tile, its Gaussians blended front to back: the nearest of all
    tiles first, then the next ones.

    Args:
        features: of each, (N, C).
        members: indices of the Gaussians of each tile, nearest first, (M,).
        starts: where each tile's begin, (T + 1,), tiles row by row.

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
            exists = ranks < counts[tiles, None]  # (t, n)
            chunk = members[torch.where(exists, starts[tiles, None] + ranks, 0)]
            alpha = (
                _batch_alphas(footprints, chunk, tiles % columns * TILE, tiles // columns * TILE)
                * exists[:, None]
            )  # (t, TILE**2, n)
            before = light[tiles, :, None]
            after = before * torch.cumprod(1 - alpha, dim=2)
            before = torch.cat([before, after[..., :-1]], dim=2)
            # once dark, a pixel stays dark
            weights = torch.where(after >= MIN_LIGHT, alpha * before, 0.0)
            blended[tiles] += weights @ features[chunk]
            light[tiles] = after[..., -1]
    return blended.view(len(counts), TILE, TILE, -1)


def _batch_alphas(splats: Footprints, chunk: Tensor, left: Tensor, top: Tensor) -> Tensor:
    """Alpha of Gaussians (t, n) at each pixel of their tiles, (t, TILE**2, n).

    Tiles begin at pixels left, top, (t,).
    """
    centres, conics = splats.centres[chunk], splats.conics[chunk, None]  # (t, n, 2), (t, n, 1, 3)
    xx, xy, yy = conics.transpose(1, 2).unbind(dim=-1)  # (t, 1, n) each
    steps = torch.arange(TILE)
    across = (left[:, None] + steps)[..., None] - centres[:, None, :, 0]  # (t, TILE, n)
    down = (top[:, None] + steps)[..., None] - centres[:, None, :, 1]
    # (t, rows, columns, n)
    power = (-0.5 * xx * across**2)[:, None] + (-0.5 * yy * down**2)[:, :, None]
    power = power - (xy * across)[:, None] * down[:, :, None]
    alpha = (torch.exp(power.clamp(min=NEGLIGIBLE)) * splats.opacities[chunk][:, None, None]).clamp(
        max=MAX_ALPHA
    )
    # above 0 by rounding alone
    return alpha.masked_fill((power > 0) | (alpha < MIN_ALPHA), 0).flatten(1, 2)
