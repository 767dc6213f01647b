"""FWD as a method: each instant from its own source frames and the depth that comes with them.

Source views are carried into the target at half its size: their points, what each of them knows,
and where they are seen.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.baselines.fwd.network import (
    POINTS_PER_PIXEL,
    FwdNetwork,
    direction_change,
    load_network,
)
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering, SourceView

RADIUS_PX = 1.5
TINY = 1e-12  # square pixels; the root has a slope there
SIZE_MULTIPLE = 4  # the decoder halves half the size once more


@dataclass(frozen=True)
class Fwd:
    """FWD-D (Cao et al. 2022), the variant that is given depth.

    Nothing is remembered from instant to instant.

    Attributes:
        weights: file of its weights, see `load_network`.
        points_per_pixel: most points that a view blends at a pixel; by default as many as the
            weights were trained with.
    """

    weights: Path
    points_per_pixel: int | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse options that mean nothing."""
        if self.points_per_pixel is not None and self.points_per_pixel < 1:
            raise RenderError(
                f"FWD: wanted at least one point per pixel, got {self.points_per_pixel}"
            )
        compute_device(self.device)

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant."""
        device = compute_device(self.device)
        network = load_network(self.weights, device)
        with rendering_on(device):
            started = clock_s(device)
            views = warp_views(network, instant, self.points_per_pixel)
            warped = clock_s(device)
            image = decode_views(network, instant, views)
        rendered = np.ascontiguousarray(image.permute(1, 2, 0).numpy(force=True))
        return Rendering(
            rendered, None, {"warp": warped - started, "decode": clock_s(device) - warped}
        )


@dataclass(frozen=True, eq=False)
class HalfView:
    """One source view at half its size.

    Attributes:
        image: (H, W, 3), in [-1, 1].
        depth: (H, W), world units, 0 where unknown.
    """

    camera: Camera
    image: Map
    depth: Map


def halve(source: SourceView) -> HalfView:
    """Mean colour of each 2 x 2 pixels, and the first known depth among them in reading order, so
    that none is invented.

    An odd row or column at the end is repeated.
    """
    height, width = source.image.shape[:2]
    bottom, right = height % 2, width % 2
    image = cv2.copyMakeBorder(source.image, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    depth = np.pad(source.depth, ((0, bottom), (0, right)), mode="edge")
    camera = halved_camera(source.camera, 2)
    fours = image.astype(np.float32).reshape(camera.height, 2, camera.width, 2, 3)
    return HalfView(camera, fours.mean(axis=(1, 3)) / np.float32(127.5) - 1, _first_known(depth))


def halved_camera(camera: Camera, multiple: int) -> Camera:
    """Return the camera at half its size, after its window was grown to the right and downwards to
    multiples of N pixels.
    """
    width, height = (-(-side // multiple) * multiple for side in camera.size)
    return camera.cropped(0, 0, width, height).resized(width // 2, height // 2)


def _first_known(depth: NDArray[np.float32]) -> Map:
    """(2 H, 2 W) to (H, W)."""
    first_depth = np.zeros_like(depth[::2, ::2])
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        first_depth = np.where(first_depth > 0, first_depth, depth[row::2, column::2])
    return np.ascontiguousarray(first_depth, np.float32)


@dataclass(frozen=True, eq=False)
class PointSplat:
    """Rendered point cloud.

    Attributes:
        features: premultiplied by coverage, (C, H, W).
        alpha: coverage, (H, W), in [0, 1].
    """

    features: Tensor
    alpha: Tensor


def splat_points(
    points: Tensor,
    features: Tensor,
    target: Camera,
    near: float,
    radius_px: float = RADIUS_PX,
    count: int = POINTS_PER_PIXEL,
) -> PointSplat:
    """Render points front to back.

    A point at distance d < r from a pixel's centre covers it by 1 - sqrt(d^2 / r^2); of those that
    do, the `count` nearest to the camera are blended, equal depths in the order of the points.

    Args:
        points: in the target camera, (N, 3), float64, world units.
        features: (N, C), float32.
        near: points at or before this depth are left out, world units.
        radius_px: r, pixels.
        count: most points per pixel.
    """
    pixels, members, alphas = _pairs(points, target, near, radius_px)
    size = target.height * target.width
    counts = torch.bincount(pixels, minlength=size)
    starts = counts.cumsum(0) - counts
    blended, light = torch.zeros(size, features.shape[1]), torch.ones(size)
    for rank in range(min(count, int(counts.max()))):
        covered = torch.nonzero(counts > rank)[:, 0]
        pair = starts[covered] + rank
        weight = light[covered] * alphas[pair]
        blended[covered] += weight[:, None] * features[members[pair]]
        light[covered] *= 1 - alphas[pair]
    shape = (target.height, target.width)
    return PointSplat(blended.T.reshape(-1, *shape), (1 - light).view(shape))


def _pairs(
    points: Tensor, target: Camera, near: float, radius_px: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Every pixel that a point covers, by pixel and nearest point first: flat pixel, index of the
    point, alpha; (M,) each.
    """
    indices = torch.nonzero(points[:, 2] > near)[:, 0]
    indices = indices[torch.sort(points[indices, 2], stable=True).indices]
    x, y, z = points[indices].unbind(dim=1)
    centres = (
        torch.stack(
            [x / z * target.K[0, 0] + target.K[0, 2], y / z * target.K[1, 1] + target.K[1, 2]],
            dim=1,
        )
        - 0.5
    )
    steps = torch.arange(math.ceil(2 * radius_px))
    places = torch.ceil(centres - radius_px)[:, :, None] + steps  # (N, 2, n)
    columns, rows = places[:, 0, None, :], places[:, 1, :, None]
    # (N, n, n)
    square = (columns - centres[:, 0, None, None]) ** 2 + (rows - centres[:, 1, None, None]) ** 2
    covered = (
        (columns >= 0)
        & (columns < target.width)
        & (rows >= 0)
        & (rows < target.height)
        & (square < radius_px**2)
    )
    owner = torch.nonzero(covered)[:, 0]  # by point, so still nearest first
    pixels = (rows * target.width + columns)[covered].long()
    alphas = (1 - torch.sqrt(square[covered].clamp(min=TINY)) / radius_px).float()
    order = torch.sort(pixels, stable=True).indices
    return pixels[order], indices[owner[order]], alphas[order]


def warp_view(
    network: FwdNetwork,
    view: HalfView,
    target: Camera,
    near: float,
    smallest: float,
    count: int = POINTS_PER_PIXEL,
) -> PointSplat:
    """Return the features of a view as the target sees them.

    Gradients reach the network's parameters.

    Args:
        near: points at or before this depth in the target are left out, world units.
        smallest: smallest depth of the scene seen from any source, world units.
        count: most points per pixel.

    Reading:
        Directions are taken in the target camera's frame, so that the world's axes do not matter,
        and depth enters the completion as a share of the largest inverse depth, 1 / `smallest`, so
        that its unit does not matter.
    """
    images = torch.as_tensor(view.image).permute(2, 0, 1)[None].contiguous()
    depth = _completed(network, images, torch.as_tensor(view.depth), smallest).flatten()
    rays, centre = _rays(view.camera, target)
    points = centre + torch.where(depth > 0, depth, torch.ones(()))[:, None] * rays  # (N, 3)
    directions = direction_change(rays, points).float().T.view(1, -1, *view.depth.shape)
    features = network.view_features(images, directions)[0].flatten(1).T.float()  # (N, width)
    indices = torch.nonzero(depth > 0)[:, 0]
    return splat_points(points[indices], features[indices], target, near, count=count)


def _completed(network: FwdNetwork, images: Tensor, depth: Tensor, smallest: float) -> Tensor:
    """Return the depth (H, W) after the completion, if the network has one.

    World units, 0 where unknown.
    """
    if network.completion is None:
        return depth
    share = torch.where(depth > 0, smallest / depth, torch.zeros(())).clamp(max=1)
    completed: Tensor = smallest / network.completion(images, share[None, None])[0, 0]
    return completed


def _rays(camera: Camera, target: Camera) -> tuple[Tensor, Tensor]:
    """Return each pixel's ray at depth 1, (H * W, 3), and the camera's centre, (3,), in the target
    camera, float64.
    """
    rays = camera.rays().reshape(-1, 3) @ target.rotation.T
    return torch.as_tensor(rays), torch.as_tensor(
        np.array(target.rotation @ camera.centre + target.translation)
    )


def warp_views(
    network: FwdNetwork, instant: Instant, points_per_pixel: int | None = None
) -> list[PointSplat]:
    """Return the features of each source as the target sees them at half its size.

    Gradients reach the network's parameters.
    """
    target = halved_camera(instant.target, SIZE_MULTIPLE)
    near = instant.near_plane
    smallest = min(source.camera.near for source in instant.sources)
    count = points_per_pixel or network.config.points_per_pixel
    return [
        warp_view(network, halve(source), target, near, smallest, count)
        for source in instant.sources
    ]


def decode_views(network: FwdNetwork, instant: Instant, views: Sequence[PointSplat]) -> Tensor:
    """Return the target view, (3, H, W) in [0, 1]."""
    decoded = network.decode(
        torch.stack([view.features for view in views]), torch.stack([view.alpha for view in views])
    )
    return decoded[:, : instant.target.height, : instant.target.width].float() / 2 + 0.5
