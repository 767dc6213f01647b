"""Few samples around the surface of each pixel, and what they add up to."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.baselines.enerf.networks import Networks
from ggvs_eval.baselines.enerf.views import SeenView
from ggvs_eval.baselines.enerf.volumes import Surface

SAMPLES = 2  # per pixel


def render_pixels(
    networks: Networks, views: Sequence[SeenView], surface: Surface, centre: Tensor, rays: Tensor, pixels: tuple[Tensor, Tensor]
) -> tuple[Tensor, Tensor]:
    """Colour and depth of some pixels.

    Args:
        networks: the trained ones.
        views: at least two.
        surface: where to look.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (N, 3).
        pixels: their rows and columns, (N,) each.

    Returns:
        RGB, (N, 3), and depth, (N,), in the network's units of length.
    """
    near, far = (bound[pixels][:, None] for bound in (surface.near, surface.far))
    depths = near + (far - near) * torch.linspace(0, 1, SAMPLES)  # (N, S)
    points_world = (centre + depths[..., None] * rays[:, None]).reshape(-1, 3)
    seen = torch.stack([view.look_up(points_world) for view in views], dim=1)
    directions = torch.stack([view.directions(points_world, centre) for view in views], dim=1)
    colours, density = networks.nerf_1(_voxels(surface, pixels, depths), seen, directions)
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


def _voxels(surface: Surface, pixels: tuple[Tensor, Tensor], depths: Tensor) -> Tensor:
    """Features of the fine volume at the samples, (N * S, 8)."""
    height, width = surface.near.shape
    first, last = surface.first[pixels][:, None], surface.last[pixels][:, None]
    rows, columns = (index[:, None].expand_as(depths) for index in pixels)
    places = torch.stack([columns / (width - 1), rows / (height - 1), (depths - first) / (last - first)], dim=-1)
    places = 2 * places.view(1, 1, 1, -1, 3) - 1
    sampled = functional.grid_sample(surface.features[None], places, padding_mode="zeros", align_corners=True)
    return sampled[0, :, 0, 0].T
