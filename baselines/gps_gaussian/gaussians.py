"""Anisotropic Gaussians in the world, and what a camera sees of each one (EWA splatting, Zwicker et al. 2001)."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.camera import Camera

BLUR_PX2 = 0.3  # added to the variance on the image, so that no Gaussian falls between the pixels
EDGE = 1.3  # beyond this share of the half field of view the projection is linearised at that edge
SIGMAS = 3  # how far a Gaussian reaches
TILE = 16  # pixels along each side of a tile; a Gaussian is evaluated in every tile that the square around it touches


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
    """All Gaussians of several sets."""
    return Gaussians(*(torch.cat([getattr(part, name) for part in parts]) for name in Gaussians.__dataclass_fields__))


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """Rotation matrices (N, 3, 3) of unit quaternions w, x, y, z, (N, 4)."""
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
    points = gaussians.centres @ rotation.T + torch.as_tensor(np.array(target.translation))  # (N, 3)
    indices = torch.nonzero(points[:, 2] > near)[:, 0]
    points = points[indices]
    focal, middle = (torch.as_tensor(np.array(values)) for values in (target.K[[0, 1], [0, 1]], target.K[:2, 2]))
    centres = (points[:, :2] / points[:, 2:] * focal + middle - 0.5).float()
    covariance = _image_covariance(points.float(), gaussians.axes[indices], gaussians.scales[indices], target)
    conics, radii = _conics(covariance)
    reach = (centres + radii[:, None] >= 0) & (centres - radii[:, None] < torch.tensor(target.size) + TILE)
    kept = torch.nonzero(reach.all(dim=1) & (radii > 0))[:, 0]
    depths, order = torch.sort(points[kept, 2].float(), stable=True)
    kept = kept[order]
    return Footprints(
        centres[kept], conics[kept], radii[kept], depths, gaussians.opacities[indices[kept]], gaussians.colours[indices[kept]]
    )


def _image_covariance(points: Tensor, axes: Tensor, scales: Tensor, target: Camera) -> Tensor:
    """Covariance on the image, entries xx, xy, yy, (N, 3): J W Sigma W^T J^T + blur, J the projection linearised."""
    fx, fy = float(target.K[0, 0]), float(target.K[1, 1])
    limit = EDGE * torch.tensor([target.width / (2 * fx), target.height / (2 * fy)])
    z = points[:, 2]
    x, y = (points[:, :2] / points[:, 2:]).clamp(-limit, limit).unbind(dim=1)
    turned = torch.as_tensor(np.array(target.rotation)).float() @ (axes * scales[:, None])  # (N, 3, 3), columns are sigmas
    across = (turned[:, 0] - x[:, None] * turned[:, 2]) * (fx / z)[:, None]  # (N, 3), first row of J W R S
    down = (turned[:, 1] - y[:, None] * turned[:, 2]) * (fy / z)[:, None]
    return torch.stack([(across**2).sum(1) + BLUR_PX2, (across * down).sum(1), (down**2).sum(1) + BLUR_PX2], dim=1)


def _conics(covariance: Tensor) -> tuple[Tensor, Tensor]:
    """Inverse of a covariance (N, 3), and `SIGMAS` standard deviations along its longer axis in whole pixels (N,)."""
    xx, xy, yy = covariance.unbind(dim=1)
    determinant = xx * yy - xy * xy
    half_trace = (xx + yy) / 2
    largest = half_trace + torch.sqrt((half_trace**2 - determinant).clamp(min=0.1))
    radii = torch.where(determinant > 0, torch.ceil(SIGMAS * torch.sqrt(largest)), torch.zeros_like(xx))
    conics = torch.stack([yy, -xy, xx], dim=1) / determinant[:, None]
    return conics, radii
