"""Rays of the target through the networks: a coarse pass, a fine pass where it found something, and what they add up to."""

from collections.abc import Sequence

import torch
from torch import Tensor

from ggvs_eval.baselines.ibrnet.networks import Networks
from ggvs_eval.baselines.ibrnet.pooling_kernel import shade_by_kernel
from ggvs_eval.baselines.ibrnet.ray_network import RayNetwork
from ggvs_eval.baselines.ibrnet.samples import coarse_depths, finer_depths
from ggvs_eval.baselines.ibrnet.views import Pass, SeenView, directions

Shaded = tuple[Tensor, Tensor, Tensor]  # colours (R, 3), share of each sample in them (R, S), depths of the samples (R, S)
# Samples times views that pass through the networks together: some 0.1 GB, and fast in the caches; on a GPU some 2 GB.
ROWS_AT_ONCE = {"cpu": 2**16, "cuda": 2**20}


def render_rays(
    networks: Networks, views: Sequence[SeenView], centre: Tensor, rays: Tensor, near: float, far: float
) -> tuple[Tensor, Tensor]:
    """Colour and depth of some rays.

    Args:
        networks: the trained ones.
        views: at least two.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (R, 3).
        near: depth of the first sample, world units.
        far: depth of the last sample.

    Returns:
        RGB, (R, 3), and expected depth, (R,), 0 where a ray met less than half an opaque surface.
    """
    _, fine = render_passes(networks, views, centre, rays, near, far)
    colours, shares, depths = fine
    total = shares.sum(dim=1)
    expected = (shares * depths).sum(dim=1) / total.clamp(min=1e-10)
    return colours, torch.where(total >= 0.5, expected, 0.0)


def render_passes(
    networks: Networks, views: Sequence[SeenView], centre: Tensor, rays: Tensor, near: float, far: float
) -> tuple[Tensor, Shaded]:
    """Colours (R, 3) of the coarse pass, and the fine pass; arguments as of `render_rays`. Gradients reach the networks."""
    count = networks.config.samples
    depths = coarse_depths(near, far, count).expand(rays.shape[0], -1)
    colours, density = _shade(networks.net_coarse, views, "coarse", centre, rays, depths)
    shares = opacity_shares(density)
    rough = (shares[..., None] * colours).sum(dim=1)
    depths = finer_depths(depths, shares.detach(), count)
    colours, density = _shade(networks.net_fine, views, "fine", centre, rays, depths)
    shares = opacity_shares(density)
    return rough, ((shares[..., None] * colours).sum(dim=1), shares, depths)


def opacity_shares(density: Tensor) -> Tensor:
    """Share of each sample in its pixel (Eq. 7 of IBRNet's paper with the density of a sample, not of a length), (R, S)."""
    alpha = 1 - torch.exp(-density)
    passing = torch.cumprod(1 - alpha + 1e-10, dim=1)[:, :-1]
    return alpha * torch.cat([torch.ones_like(alpha[:, :1]), passing], dim=1)


def rays_at_once(views: int, samples: int, device: torch.device | None = None) -> int:
    """How many rays of so many coarse samples may pass through the networks together on a device, the CPU unless given."""
    return max(1, ROWS_AT_ONCE[device.type if device else "cpu"] // (2 * samples * views))


def _shade(
    network: RayNetwork, views: Sequence[SeenView], of_pass: Pass, centre: Tensor, rays: Tensor, depths: Tensor
) -> tuple[Tensor, Tensor]:
    """RGB (R, S, 3) and density (R, S) of the samples at the depths (R, S); compiled on the CPU where nobody wants gradients."""
    if rays.device.type == "cpu" and not (torch.is_grad_enabled() and network.s.requires_grad):
        return shade_by_kernel(network, views, of_pass, centre, rays, depths)
    points_world = centre + depths[..., None] * rays[:, None]  # (R, S, 3)
    looked_up = [view.look_up(points_world, of_pass) for view in views]
    seen = torch.stack([values for values, _ in looked_up], dim=2)
    visible = torch.stack([inside for _, inside in looked_up], dim=2)
    differences = torch.stack([directions(points_world, centre, view.centre) for view in views], dim=2)
    colours, density = network(seen, differences, visible)
    return colours.float(), density.float()
