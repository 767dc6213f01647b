"""Gaussians in the world to ellipses in an image: the projection of 3D Gaussian splatting, readable, in torch."""

from dataclasses import dataclass
from math import log

import torch

from ggvs_eval.camera import Camera
from ggvs_eval.gaussians.cloud import GaussianCloud
from ggvs_eval.gaussians.harmonics import colours

LOW_PASS_PX2 = 0.3  # added to both variances in the image, so that no Gaussian falls between the pixels
LEAST_ALPHA = 1 / 255  # what covers less of a pixel does not touch it
SLOPE_MARGIN = 0.3  # of half the image's extent: by how far outside the slopes of the Jacobian are held


@dataclass(frozen=True, eq=False)
class Ellipses:
    """Gaussians in an image; rows of Gaussians that are not visible are without meaning.

    Attributes:
        centres: pixel index coordinates (integers are pixel centres), (N, 2).
        conics: a, b, c of the quadratic form a dx^2 + 2 b dx dy + c dy^2 of the inverse covariance, (N, 3).
        reach: half extents of the box outside of which alpha is below 1/255, pixels, (N, 2).
        radii: 3 standard deviations along the longer axis, rounded up, pixels, 0 where not visible, (N,) int32.
        opacities: (N,), in (0, 1).
        colours: as seen from the camera, (N, 3), not below 0.
        depths: z of the centres in the camera, (N,).
        visible: (N,), True where a Gaussian touches the image.
    """

    centres: torch.Tensor
    conics: torch.Tensor
    reach: torch.Tensor
    radii: torch.Tensor
    opacities: torch.Tensor
    colours: torch.Tensor
    depths: torch.Tensor
    visible: torch.Tensor


def project(cloud: GaussianCloud, camera: Camera, near: float) -> Ellipses:
    """Project every Gaussian: cov2d = J W Sigma W^T J^T + 0.3 I, with the Jacobian J of the pinhole K at the Gaussian's centre.

    Args:
        near: Gaussians at or before this depth are left out, world units.

    Reading:
        The reference builds its projection from fields of view and holds the slopes x/z and y/z of the Jacobian within 1.3
        tan(fov / 2). With the principal point off the middle the same margin is kept beyond each border of the image: for a
        principal point in the middle both are the same.
    """
    rotation, shift, centre = (
        torch.tensor(part, dtype=cloud.means.dtype, device=cloud.means.device)
        for part in (camera.rotation, camera.translation, camera.centre)
    )
    x, y, z = (cloud.means @ rotation.T + shift).unbind(-1)
    in_front = z > near
    z = torch.where(in_front, z, 1)  # what is left out may lie at 0
    fx, fy, cx, cy = (float(camera.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    centres = torch.stack([fx * x / z + (cx - 0.5), fy * y / z + (cy - 0.5)], -1)  # pixel centres at integers

    slope_x, slope_y = _held(x / z, fx, cx, camera.width), _held(y / z, fy, cy, camera.height)
    zero = torch.zeros_like(z)
    jacobian = torch.stack([fx / z, zero, -fx * slope_x / z, zero, fy / z, -fy * slope_y / z], -1).reshape(-1, 2, 3)
    axes = rotations(cloud.quaternions) * cloud.log_scales.exp()[:, None, :]  # (N, 3, 3): columns are the axes, of their lengths
    row_x, row_y = (jacobian @ rotation @ axes).unbind(1)  # (N, 3) each: cov2d is the matrix of their products
    var_x, var_y = (row_x * row_x).sum(-1), (row_y * row_y).sum(-1)
    covariance = (row_x * row_y).sum(-1)
    # Lagrange's identity for var_x var_y - covariance^2, which would cancel for thin Gaussians.
    plain = torch.linalg.cross(row_x, row_y, dim=-1).square().sum(-1)
    determinant = plain + LOW_PASS_PX2 * (var_x + var_y) + LOW_PASS_PX2**2
    var_x, var_y = var_x + LOW_PASS_PX2, var_y + LOW_PASS_PX2
    conics = torch.stack([var_y, -covariance, var_x], -1) / determinant[:, None]

    opacities = cloud.opacity_logits.sigmoid()
    # alpha = o exp(-q / 2) >= 1/255 holds up to q = 2 ln(255 o); the bound is a little generous, alpha itself decides.
    furthest = (2 * (opacities.detach().log() - log(LEAST_ALPHA)) + 0.01).clamp_min(0)
    reach = (furthest[:, None] * torch.stack([var_x, var_y], -1).detach()).sqrt()
    last = torch.tensor([camera.width - 1, camera.height - 1], device=reach.device)
    inside = ((centres.detach() + reach >= 0) & (centres.detach() - reach <= last)).all(-1)
    visible = in_front & inside & (opacities >= LEAST_ALPHA) & determinant.isfinite()
    radii = torch.where(visible, _radii(var_x.detach(), var_y.detach(), determinant.detach()), 0).to(torch.int32)

    directions = torch.nn.functional.normalize(cloud.means - centre, dim=-1)
    seen_colours = colours(cloud.sh, directions)
    return Ellipses(centres, conics, reach, radii, opacities, seen_colours, z, visible)


def rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """Rotation matrices of quaternions of any length but 0, w first: (N, 4) -> (N, 3, 3)."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, -1).reshape(-1, 3, 3)


def _held(slope: torch.Tensor, focal: float, principal: float, size: int) -> torch.Tensor:
    margin = SLOPE_MARGIN * size / (2 * focal)
    return slope.clamp(-principal / focal - margin, (size - principal) / focal + margin)


def _radii(var_x: torch.Tensor, var_y: torch.Tensor, determinant: torch.Tensor) -> torch.Tensor:
    middle = (var_x + var_y) / 2
    largest = middle + (middle * middle - determinant).clamp_min(0.1).sqrt()
    return (3 * largest.sqrt()).ceil().clamp_max(2**30)
