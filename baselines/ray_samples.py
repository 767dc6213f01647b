"""Samples along rays in the networks of several baselines: how much each is seen, and from
where.
"""

import torch
from torch import Tensor

EPSILON = 1e-6


def ray_changes(points_world: Tensor, centre: Tensor, other_centre: Tensor) -> Tensor:
    """Compare the rays from points to two cameras.

    Args:
        points_world: (..., 3).
        centre: of a camera, (3,).
        other_centre: of the camera whose ray is subtracted, (3,).

    Returns:
        Unit difference of the rays and their dot product, (..., 4).
    """
    ray, other_ray = (_unit(camera - points_world) for camera in (centre, other_centre))
    difference = ray - other_ray
    length = difference.norm(dim=-1, keepdim=True).clamp(min=EPSILON)
    return torch.cat([difference / length, (ray * other_ray).sum(dim=-1, keepdim=True)], dim=-1)


def opacity_shares(density: Tensor) -> Tensor:
    """Return the share of each sample in its pixel, front to back, (R, S).

    Eq. 7 of IBRNet's paper with the density of a sample, not of a length.
    """
    alpha = 1 - torch.exp(-density)
    passing = torch.cumprod(1 - alpha + 1e-10, dim=1)[:, :-1]
    return alpha * torch.cat([torch.ones_like(alpha[:, :1]), passing], dim=1)


def _unit(vectors: Tensor) -> Tensor:
    return vectors / (vectors.norm(dim=-1, keepdim=True) + EPSILON)
