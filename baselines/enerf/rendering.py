"""Few samples around the surface of each pixel, and what they add up to; coarsely, too, which teaches the coarse volume."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.baselines.enerf.network import Networks
from ggvs_eval.baselines.enerf.views import SeenView
from ggvs_eval.baselines.enerf.volumes import CoarseSurface, Surface
from ggvs_eval.camera import Camera

SAMPLES = 2  # per pixel
PIXELS_AT_ONCE = 2**14  # on a CPU
COARSE_SAMPLES = 8  # per pixel of the coarse picture, ...
COARSE_FACTOR = 4  # ... whose pixels are so many times as large as the target's


def render_pixels(
    networks: Networks, views: Sequence[SeenView], surface: Surface, centre: Tensor, rays: Tensor, pixels: tuple[Tensor, Tensor]
) -> tuple[Tensor, Tensor]:
    """Colour and depth of some pixels.

    Args:
        views: at least two.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (N, 3).
        pixels: their rows and columns, (N,) each.

    Returns:
        RGB, (N, 3), and depth, (N,), in the network's units of length.
    """
    near, far = (bound[pixels][:, None] for bound in (surface.near, surface.far))
    depths = near + (far - near) * torch.linspace(0, 1, SAMPLES)  # (N, S)
    points_world = (centre + depths[..., None] * rays[:, None]).reshape(-1, 3)
    view_features = torch.stack([view.look_up(points_world) for view in views], dim=1)
    directions = torch.stack([view.directions(points_world, centre) for view in views], dim=1)
    colours, density = networks.nerf_1(_fine_voxels(surface, pixels, depths), view_features, directions)
    return composite(colours.view(-1, SAMPLES, 3), density.view(-1, SAMPLES).float(), depths)


def composite(colours: Tensor, density: Tensor, depths: Tensor) -> tuple[Tensor, Tensor]:
    """Colours (N, S, 3), front to back, and expected depth (N,) of samples with density (N, S) at depths (N, S).

    Reading:
        Depth is the mean under the softmax of the samples' shares, as in the authors' code.
    """
    alpha = 1 - torch.exp(-density)
    passing = torch.cumprod(1 - alpha + 1e-10, dim=1)[:, :-1]
    shares = alpha * torch.cat([torch.ones_like(alpha[:, :1]), passing], dim=1)
    return (shares[..., None] * colours).sum(dim=1), (torch.softmax(shares, dim=1) * depths).sum(dim=1)


def _fine_voxels(surface: Surface, pixels: tuple[Tensor, Tensor], depths: Tensor) -> Tensor:
    """Features of the fine volume at the samples, (N * S, 8)."""
    height, width = surface.near.shape
    first, last = surface.first[pixels][:, None], surface.last[pixels][:, None]
    rows, columns = (index[:, None].expand_as(depths) for index in pixels)
    places = torch.stack([columns / (width - 1), rows / (height - 1), (depths - first) / (last - first)], dim=-1)
    places = 2 * places.view(1, 1, 1, -1, 3) - 1
    sampled = functional.grid_sample(surface.features[None], places, padding_mode="zeros", align_corners=True)
    return sampled[0, :, 0, 0].T


def render_surface(
    networks: Networks,
    views: list[SeenView],
    surface: Surface,
    target: Camera,
    unit: float,
    pixels_per_chunk: int = PIXELS_AT_ONCE,
) -> tuple[Tensor, Tensor]:
    """RGB (3, H, W) and depth (H, W) in world units, by so many pixels at once; gradients reach the networks' parameters."""
    centre = torch.as_tensor(target.centre * unit).float()
    rays = torch.as_tensor(target.rays().reshape(-1, 3)).float()
    parts = []
    for chunk in torch.arange(len(rays)).split(pixels_per_chunk):
        pixels = torch.div(chunk, target.width, rounding_mode="floor"), chunk % target.width
        parts.append(render_pixels(networks, views, surface, centre, rays[chunk], pixels))
    image = torch.cat([colours for colours, _ in parts]).T.reshape(3, target.height, target.width)
    return image, torch.cat([depths for _, depths in parts]).view(target.height, target.width) / unit


def coarse_views(views: Sequence[SeenView]) -> list[SeenView]:
    """The views at a quarter of their size: the features of that level, and the mean colour of each 4 x 4 pixels."""
    small = []
    for view in views:
        colours = functional.interpolate(
            view.shown[-3:][None], scale_factor=1 / COARSE_FACTOR, mode="bilinear", align_corners=True
        )[0]
        K = view.K.copy()
        K[:2] /= COARSE_FACTOR  # as the volumes: pixel (0, 0) is the same place at every scale
        small.append(replace(view, shown=torch.cat([view.levels[0], colours]), K=K))
    return small


def render_coarsely(
    networks: Networks, views: Sequence[SeenView], surface: CoarseSurface, centre: Tensor, rays: Tensor
) -> tuple[Tensor, Tensor]:
    """Colour and depth of each fourth pixel of every fourth row.

    Args:
        views: as `coarse_views` gives them.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (H / 4, W / 4, 3).

    Returns:
        RGB, (N, 3), and depth, (N,), row by row.
    """
    height, width = rays.shape[:2]
    near, far = (bound[:height, :width].reshape(-1, 1) for bound in surface.range_at(2))
    depths = near + (far - near) * torch.linspace(0, 1, COARSE_SAMPLES)  # (N, S)
    points_world = (centre + depths[..., None] * rays.reshape(-1, 1, 3)).reshape(-1, 3)
    view_features = torch.stack([view.look_up(points_world) for view in views], dim=1)
    directions = torch.stack([view.directions(points_world, centre) for view in views], dim=1)
    colours, density = networks.nerf_0(_coarse_voxels(surface, depths, height, width), view_features, directions)
    return composite(colours.view(-1, COARSE_SAMPLES, 3), density.view(-1, COARSE_SAMPLES).float(), depths)


def _coarse_voxels(surface: CoarseSurface, depths: Tensor, height: int, width: int) -> Tensor:
    """Features of the coarse volume at the samples (N, S), (N * S, 8)."""
    whole = (2 * side - 1 for side in surface.mean.shape)  # index of the last pixel, padded ones included
    sides = (2 * torch.arange(side) / last - 1 for side, last in zip((height, width), whole, strict=True))
    rows, columns = torch.meshgrid(*sides, indexing="ij")
    share = (1 / depths - 1 / surface.near) / (1 / surface.far - 1 / surface.near)
    across, down = (index.reshape(-1, 1).expand_as(depths) for index in (columns, rows))
    places = torch.stack([across, down, 2 * share - 1], dim=-1).view(1, 1, 1, -1, 3)
    sampled = functional.grid_sample(surface.features[None], places, padding_mode="zeros", align_corners=True)
    return sampled[0, :, 0, 0].T
