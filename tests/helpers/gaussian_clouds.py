"""Clouds of 3D Gaussians to render, and cameras that see them."""

import cv2
import numpy as np
import torch

from ggvs_eval.camera import Camera
from ggvs_eval.gaussians import GaussianCloud


def random_cloud(
    count: int, degree: int = 3, seed: int = 0, dtype: torch.dtype = torch.float64
) -> GaussianCloud:
    """Long, thin and turned Gaussians before a camera at the origin, some behind it and some beside
    its image.
    """
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    z = 0.5 + 4 * torch.rand(count, 1, generator=draw, dtype=torch.float64)
    means = torch.cat([normal(count, 2) * z * 0.3, z], 1)
    means[::11, 2] *= -1
    sh = 0.3 * normal(count, (degree + 1) ** 2, 3)
    cloud = GaussianCloud(
        means, -2.5 + 0.7 * normal(count, 3), normal(count, 4), 2 * normal(count), sh
    )
    return cloud.to(dtype=dtype)


def view_of(
    width: int,
    height: int,
    *,
    cx: float | None = None,
    cy: float | None = None,
    turned: bool = False,
) -> Camera:
    """A camera at the origin, or near it and turned, with a focal length of 50 pixels."""
    K = np.array(
        [
            [50.0, 0, width / 2 if cx is None else cx],
            [0, 50.0, height / 2 if cy is None else cy],
            [0, 0, 1],
        ]
    )
    pose = np.eye(4)
    if turned:
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(np.array([0.1, -0.2, 0.3]))[0], (0.2, -0.1, 0.3)
    return Camera("view", K, pose, width, height, near=0.5, far=50.0)
