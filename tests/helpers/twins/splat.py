"""The splat in a page of torch: every Gaussian against every pixel, in float64. The steps are those
of 3D Gaussian splatting.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.splat import Splat, float_features
from ggvs_eval.method import SourceView


def splat_twin(
    sources: Sequence[SourceView],
    target: Camera,
    *,
    near: float,
    scale: float = 0.5,
    normalised: bool = True,
) -> Splat:
    """What `ggvs_eval.geometry.splat` computes; memory grows with Gaussians times pixels."""
    parts = [_gaussians(source, target, near, scale) for source in sources]
    centres, conics, depths, features, keys = (torch.cat(part) for part in zip(*parts, strict=True))
    order = torch.argsort(keys, stable=True)  # step 5
    alpha = _alpha(centres[order], conics[order], target)  # (N, P)
    after = torch.cumprod(1 - alpha, dim=0)
    before = torch.cat([torch.ones_like(after[:1]), after])[: len(alpha)]
    # steps 6 and 7: stop before T falls below 1e-4
    weight = torch.where(after >= 1e-4, alpha * before, 0.0)
    coverage = weight.sum(dim=0)
    sums = torch.cat([features[order], depths[order, None]], dim=1).T @ weight  # (C + 1, P)
    if normalised:
        sums = torch.where(coverage > 1 / 255, sums / coverage, 0.0)  # step 8
    images = sums.reshape(len(sums), target.height, target.width).numpy().astype(np.float32)
    alpha_image = coverage.reshape(target.height, target.width).numpy().astype(np.float32)
    return Splat(np.ascontiguousarray(images[:-1].transpose(1, 2, 0)), alpha_image, images[-1])


def _gaussians(
    source: SourceView, target: Camera, near: float, scale: float
) -> tuple[torch.Tensor, ...]:
    """Of visible Gaussians: centres in pixel indices (N, 2), inverse covariances (N, 2, 2), depths,
    features (N, C), keys.
    """
    valid = source.depth > 0
    z_source = source.depth[valid].astype(np.float64)
    points = source.camera.unproject(source.camera.pixel_centres()[valid], z_source)
    x, y, z = torch.from_numpy(points @ target.rotation.T + target.translation).unbind(dim=1)
    visible = z > near  # step 1
    x, y, z, z_source = x[visible], y[visible], z[visible], torch.from_numpy(z_source)[visible]
    fx, fy, cx, cy = (float(target.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    centres = torch.stack([fx * x / z + cx - 0.5, fy * y / z + cy - 0.5], dim=1)  # step 2

    sigma = scale * z_source / source.camera.focal_px
    limit_x, limit_y = 1.3 * target.width / (2 * fx), 1.3 * target.height / (2 * fy)
    slope_x, slope_y = (x / z).clamp(-limit_x, limit_x), (y / z).clamp(-limit_y, limit_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [fx / z, zero, -fx * slope_x / z, zero, fy / z, -fy * slope_y / z], dim=1
    ).reshape(-1, 2, 3)
    # step 3
    covariance = sigma[:, None, None] ** 2 * jacobian @ jacobian.mT + 0.3 * torch.eye(
        2, dtype=torch.float64
    )
    features = torch.from_numpy(float_features(source.image)[valid].astype(np.float64))[visible]
    keys = torch.from_numpy(_sort_keys(source, target)[valid])[visible]
    return centres, torch.linalg.inv(covariance), z, features, keys


def _sort_keys(source: SourceView, target: Camera) -> NDArray[np.float32]:
    """Depth in the target camera as float32 arithmetic gives it, (H, W): near ties are part of the
    definition.
    """
    turn = target.rotation @ source.camera.rotation.T
    row = (turn @ np.linalg.inv(source.camera.K))[2].astype(np.float32)
    offset = np.float32(target.translation[2] - turn[2] @ source.camera.translation)
    u, v = np.moveaxis(source.camera.pixel_centres().astype(np.float32), -1, 0)
    return source.depth.astype(np.float32) * (row[0] * u + row[1] * v + row[2]) + offset


def _alpha(centres: torch.Tensor, conics: torch.Tensor, target: Camera) -> torch.Tensor:
    """Opacity of each Gaussian at each pixel, (N, P), 0 where below 1/255 (step 6)."""
    rows, columns = torch.meshgrid(
        torch.arange(target.height), torch.arange(target.width), indexing="ij"
    )
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2).double()  # (P, 2)
    offset = pixels[None] - centres[:, None]  # (N, P, 2)
    quadratic = torch.einsum("npi,nij,npj->np", offset, conics, offset)
    alpha = torch.exp(-0.5 * quadratic).clamp(max=0.99)
    return torch.where(alpha >= 1 / 255, alpha, 0.0)
