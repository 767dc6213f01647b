"""Gaussians in the world from the network's output at each pixel."""

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn import functional

from ggvs_eval.contrib.more_baselines.mvsplat.depth import OFFSET, QUATERNION, SCALES, PixelMaps
from ggvs_eval.contrib.more_baselines.mvsplat.views import Views
from ggvs_eval.gaussians.cloud import GaussianCloud, coefficients_of, turned_harmonics

LEAST_SCALE, LARGEST_SCALE = 0.5, 15.0  # of tenths of the sum of a pixel's sides
TENTH = 0.1
RENDERED_DEGREE = 3  # the authors' rasteriser knows no harmonics above it

# Their harmonics are turned as e3nn turns its own, whose first degree is (x, y, z); that of what
# renders them is (-y, z, -x).
OTHER_AXES = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])


def pixel_cloud(pixels: PixelMaps, views: Views, published: bool) -> GaussianCloud:
    """Return the Gaussians of all pixels of all images, view after view, row after row, in world
    units.

    Reading:
        The authors search depth along the optical axis and place Gaussians as if it were distance
        from the camera; their harmonics are turned to the world in the axes of another library.
        Their weights know nothing else, so `published` does the same. Without it depth is z,
        harmonics turn with the camera, and the constant colour is that of the pixel plus what the
        network says, as half an hour of training would not teach it to copy.
    """
    return _joined([_view_cloud(pixels, views, number, published) for number in range(len(views))])


def rendered_part(cloud: GaussianCloud) -> GaussianCloud:
    """Return the cloud without the harmonics that the authors' rasteriser leaves out."""
    terms = (RENDERED_DEGREE + 1) ** 2
    return GaussianCloud(
        means=cloud.means,
        log_scales=cloud.log_scales,
        quaternions=cloud.quaternions,
        opacity_logits=cloud.opacity_logits,
        sh=cloud.sh[:, :terms].contiguous(),
    )


def _view_cloud(pixels: PixelMaps, views: Views, number: int, published: bool) -> GaussianCloud:
    width, height = views.sizes[number].tolist()
    raw, disparity, logit, image = (
        maps[number, :, :height, :width].flatten(1).T
        for maps in (pixels.shape, pixels.disparity, pixels.opacity_logit, views.images)
    )  # (N, C), (N, 1), (N, 1), (N, 3)
    offset, scale, quaternion, colour = raw.tensor_split(
        [OFFSET, OFFSET + SCALES, OFFSET + SCALES + QUATERNION], dim=1
    )
    pose, K = views.camera_to_world[number], views.K[number]
    rotation, centre = (
        torch.as_tensor(pose[:3, :3]),
        torch.as_tensor(pose[:3, 3] / views.unit).float(),
    )

    rays = _rays(K, width, height, offset.sigmoid())
    if published:
        rays = functional.normalize(rays, dim=1)
    depth = 1 / (views.unit * disparity)  # world units
    means = rays * depth @ rotation.T.float() + centre
    spread = LEAST_SCALE + (LARGEST_SCALE - LEAST_SCALE) * scale.sigmoid()
    log_scales = (spread * depth * float(TENTH * (1 / K[0, 0] + 1 / K[1, 1]))).log()
    quaternions = _turned_quaternions(functional.normalize(quaternion, dim=1), pose[:3, :3])

    sh = colour.reshape(len(raw), 3, -1).transpose(1, 2)  # (N, terms, 3)
    sh = sh * _attenuation(sh.shape[1])[:, None]
    if not published:
        sh = torch.cat([sh[:, :1] + coefficients_of(image)[:, None], sh[:, 1:]], dim=1)
    axes = torch.as_tensor(OTHER_AXES if published else np.eye(3))
    return GaussianCloud(
        means=means,
        log_scales=log_scales,
        quaternions=quaternions,
        opacity_logits=logit[:, 0].contiguous(),
        sh=turned_harmonics(sh, axes.T @ rotation @ axes).contiguous(),
    )


def _rays(K: NDArray[np.float64], width: int, height: int, places: Tensor) -> Tensor:
    """Return the rays of z = 1 through places in [0, 1] of every pixel (N, 2), row after row, (N,
    3).
    """
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    corners = torch.stack([columns, rows], dim=-1).reshape(-1, 2).float()
    focal, middle = (torch.as_tensor(values).float() for values in (K[[0, 1], [0, 1]], K[:2, 2]))
    slopes = (corners + places - middle) / focal
    return torch.cat([slopes, torch.ones_like(slopes[:, :1])], dim=1)


def _attenuation(terms: int) -> Tensor:
    """By which each harmonic is multiplied, so that colours begin almost the same from everywhere,
    (terms,).
    """
    degrees = torch.arange(terms).float().sqrt().floor()
    return torch.where(degrees == 0, 1.0, 0.1 * 0.25**degrees)


def _turned_quaternions(quaternions: Tensor, rotation: NDArray[np.float64]) -> Tensor:
    """Return the unit quaternions with their real part last, then a rotation.

    The product with its real part first, (N, 4).
    """
    *axis, w = Rotation.from_matrix(rotation).as_quat().tolist()
    turn = quaternions.new_tensor(axis).expand(len(quaternions), 3)
    vectors, real = quaternions[:, :3], quaternions[:, 3:]
    imaginary = w * vectors + real * turn + torch.linalg.cross(turn, vectors)
    return torch.cat([w * real - (turn * vectors).sum(dim=1, keepdim=True), imaginary], dim=1)


def _joined(clouds: list[GaussianCloud]) -> GaussianCloud:
    return GaussianCloud(
        *(
            torch.cat(parts)
            for parts in zip(*(cloud.parameters().values() for cloud in clouds), strict=True)
        )
    )
