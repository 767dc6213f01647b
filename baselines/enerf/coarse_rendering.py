"""The picture that the coarse volume alone gives: it serves the training, where it teaches that volume."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.baselines.enerf.networks import Networks
from ggvs_eval.baselines.enerf.rendering import composite
from ggvs_eval.baselines.enerf.views import SeenView
from ggvs_eval.baselines.enerf.volumes import CoarseSurface

COARSE_SAMPLES = 8  # per pixel
SCALE = 4  # its pixels are so many times as large as the target's


def coarse_views(views: Sequence[SeenView]) -> list[SeenView]:
    """The views at a quarter of their size: the features of that level, and the mean colour of each 4 x 4 pixels."""
    small = []
    for view in views:
        colours = functional.interpolate(view.shown[-3:][None], scale_factor=1 / SCALE, mode="bilinear", align_corners=True)[0]
        K = view.K.copy()
        K[:2] /= SCALE  # as the volumes: pixel (0, 0) is the same place at every scale
        small.append(replace(view, shown=torch.cat([view.levels[0], colours]), K=K))
    return small


def render_coarsely(
    networks: Networks, views: Sequence[SeenView], surface: CoarseSurface, centre: Tensor, rays: Tensor
) -> tuple[Tensor, Tensor]:
    """Colour and depth of each fourth pixel of every fourth row.

    Args:
        networks: to be trained.
        views: as `coarse_views` gives them.
        surface: where to look.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (H / 4, W / 4, 3).

    Returns:
        RGB, (N, 3), and depth, (N,), row by row.
    """
    height, width = rays.shape[:2]
    near, far = (bound[:height, :width].reshape(-1, 1) for bound in surface.range_at(2))
    depths = near + (far - near) * torch.linspace(0, 1, COARSE_SAMPLES)  # (N, S)
    points_world = (centre + depths[..., None] * rays.reshape(-1, 1, 3)).reshape(-1, 3)
    seen = torch.stack([view.look_up(points_world) for view in views], dim=1)
    directions = torch.stack([view.directions(points_world, centre) for view in views], dim=1)
    colours, density = networks.nerf_0(_voxels(surface, depths, height, width), seen, directions)
    return composite(colours.view(-1, COARSE_SAMPLES, 3), density.view(-1, COARSE_SAMPLES).float(), depths)


def _voxels(surface: CoarseSurface, depths: Tensor, height: int, width: int) -> Tensor:
    """Features of the coarse volume at the samples (N, S), (N * S, 8)."""
    whole = (2 * side - 1 for side in surface.mean.shape)  # index of the last pixel, padded ones included
    sides = (2 * torch.arange(side) / last - 1 for side, last in zip((height, width), whole, strict=True))
    rows, columns = torch.meshgrid(*sides, indexing="ij")
    share = (1 / depths - 1 / surface.near) / (1 / surface.far - 1 / surface.near)
    across, down = (index.reshape(-1, 1).expand_as(depths) for index in (columns, rows))
    places = torch.stack([across, down, 2 * share - 1], dim=-1).view(1, 1, 1, -1, 3)
    sampled = functional.grid_sample(surface.features[None], places, padding_mode="zeros", align_corners=True)
    return sampled[0, :, 0, 0].T
