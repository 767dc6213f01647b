"""Few samples around the surface of each pixel, and what they add up to.

Coarsely, too, which teaches the coarse volume.

The surface is found in two cost volumes before the target: a coarse one over the whole range of
depth, a fine one around that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.baselines.enerf.network import CostNetwork, Networks
from ggvs_eval.baselines.enerf.views import (
    Matrix,
    SeenView,
    extrinsics,
    image_places,
    padded,
    projection,
    sample,
)
from ggvs_eval.baselines.ray_samples import opacity_shares, ray_changes
from ggvs_eval.camera import Camera

COARSE_SCALE, FINE_SCALE = 1 / 8, 1 / 2  # of the volumes' planes
FEATURE_SCALES = 1 / 4, 1 / 2  # of the features that they are made of
FINE_PLANES = 8
SMALLEST_VARIANCE = 1e-10  # of an expected depth
SAMPLES = 2  # per pixel
PIXELS_AT_ONCE = 2**14  # on a CPU
COARSE_SAMPLES = 8  # per pixel of the coarse picture, ...
COARSE_FACTOR = 4  # ... with pixels N times as large as the target's


@dataclass(frozen=True)
class TargetGrid:
    """The target's pixels, padded to a multiple of 32.

    Attributes:
        K: intrinsics, pixel centres at whole numbers, (3, 3).
        world_to_camera: (4, 4).
        width: padded, pixels.
        height: padded, pixels.
    """

    K: Matrix
    world_to_camera: Matrix
    width: int
    height: int


@dataclass(frozen=True)
class Surface:
    """Surface estimate of both cost volumes.

    Attributes:
        features: of the fine volume's cells, (8, D, H / 2, W / 2).
        first: depth of its first plane at each pixel, (H, W).
        last: depth of its last plane, (H, W).
        near: depth at which a pixel's samples begin, (H, W).
        far: depth at which they end, (H, W).
    """

    features: Tensor
    first: Tensor
    last: Tensor
    near: Tensor
    far: Tensor


@dataclass(frozen=True)
class CoarseSurface:
    """Surface estimate of the coarse cost volume.

    Attributes:
        features: of its cells, (8, D, H / 8, W / 8).
        mean: expected inverse depth, (H / 8, W / 8).
        deviation: its standard deviation, (H / 8, W / 8).
        near: depth of the first plane.
        far: depth of the last plane.
    """

    features: Tensor
    mean: Tensor
    deviation: Tensor
    near: float
    far: float

    def range_at(self, factor: int) -> tuple[Tensor, Tensor]:
        """Return the depths between which the surface is assumed, on N times as many pixels, (H',
        W') twice.
        """
        mean, deviation = _enlarge(self.mean, factor), _enlarge(self.deviation, factor)
        return 1 / (mean + deviation).clamp(max=1 / self.near), 1 / (mean - deviation).clamp(
            min=1 / self.far
        )


def find_surface(
    networks: Networks,
    views: Sequence[SeenView],
    target: TargetGrid,
    near: float,
    far: float,
    planes: int,
) -> Surface:
    """Search depth between near and far, coarsely and then around the expectation.

    Args:
        views: at least two.
        near: depth of the first coarse plane, in the network's units of length.
        planes: number of coarse planes, a multiple of 4.
    """
    return refine_surface(
        networks, views, target, search_coarsely(networks, views, target, near, far, planes)
    )


def search_coarsely(
    networks: Networks,
    views: Sequence[SeenView],
    target: TargetGrid,
    near: float,
    far: float,
    planes: int,
) -> CoarseSurface:
    """Return the first search; arguments as of `find_surface`."""
    inverse = torch.linspace(1 / near, 1 / far, planes)[:, None, None]
    cells = int(target.height * COARSE_SCALE), int(target.width * COARSE_SCALE)
    features, scores = _regularised(
        networks.cost_reg_0, views, target, 0, (1 / inverse).expand(-1, *cells)
    )
    return CoarseSurface(features, *expectation(scores, inverse), near, far)


def refine_surface(
    networks: Networks, views: Sequence[SeenView], target: TargetGrid, coarse: CoarseSurface
) -> Surface:
    """Return the second search, around what the first one found."""
    first, last = coarse.range_at(4)
    depths = first + (last - first) * torch.linspace(0, 1, FINE_PLANES)[:, None, None]
    features, scores = _regularised(networks.cost_reg_1, views, target, 1, depths)
    mean, deviation = expectation(scores, depths)
    first, last = _enlarge(first, 2), _enlarge(last, 2)
    begin, end = _enlarge(mean - deviation, 2), _enlarge(mean + deviation, 2)
    return Surface(
        features=features,
        first=first,
        last=last,
        near=torch.maximum(begin, first),
        far=torch.minimum(end, last),
    )


def disagreement(
    views: Sequence[SeenView], target: TargetGrid, level: int, depths: Tensor
) -> Tensor:
    """Return the variance of the views' features over planes before the target.

    Args:
        views: at least two.
        level: 0 the coarse, 1 the fine volume.
        depths: of the planes' cells, (D, h, w).

    Returns:
        (C, D, h, w). A view contributes zeros where it does not see a cell, as in the authors'
        volume.
    """
    image_to_world = np.linalg.inv(
        projection(target.K, target.world_to_camera, (COARSE_SCALE, FINE_SCALE)[level])
    )
    warps = [
        torch.as_tensor(view.projection(FEATURE_SCALES[level]) @ image_to_world).float()
        for view in views
    ]
    rows, columns = torch.meshgrid(
        *(torch.arange(side, dtype=torch.float32) for side in depths.shape[1:]), indexing="ij"
    )
    pixels = torch.stack([columns, rows, torch.ones_like(rows)], dim=-1)  # (h, w, 3)
    volume = []
    # one plane at a time: the warped features of all would not fit for large images
    for depth in depths:
        warped = []
        for view, warp in zip(views, warps, strict=True):
            projected = (pixels @ warp[:3, :3].T) * depth[..., None] + warp[:3, 3]
            warped.append(
                sample(view.levels[level], image_places(projected, view.levels[level]), "zeros")
            )
        volume.append(torch.stack(warped).var(dim=0, correction=0))
    return torch.stack(volume, dim=1)


def _regularised(
    network: CostNetwork, views: Sequence[SeenView], target: TargetGrid, level: int, depths: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the features (8, D, h, w) and scores (D, h, w)."""
    features, scores = network(disagreement(views, target, level, depths)[None])
    return features[0].float(), scores[0].float()


def _enlarge(values: Tensor, factor: int) -> Tensor:
    """(h, w) to (factor h, factor w); the outermost pixels stay where they are."""
    return functional.interpolate(
        values[None, None], scale_factor=factor, mode="bilinear", align_corners=True
    )[0, 0]


def expectation(scores: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean and standard deviation of values under the softmax of their scores.

    Args:
        scores: (D, H, W).
        values: broadcastable to it.

    Returns:
        (H, W) twice; the deviation is at least 1e-5.
    """
    shares = torch.softmax(scores, dim=0)
    mean = (shares * values).sum(dim=0)
    variance = (shares * (values - mean) ** 2).sum(dim=0)
    return mean, variance.clamp(min=SMALLEST_VARIANCE).sqrt()


def target_grid(target: Camera, unit: float = 1.0) -> TargetGrid:
    """Return the target's padded pixels; `unit` is the network's units of length per world unit."""
    return TargetGrid(
        K=target.K_opencv,
        world_to_camera=extrinsics(target, unit),
        width=padded(target.width),
        height=padded(target.height),
    )


def render_pixels(
    networks: Networks,
    views: Sequence[SeenView],
    surface: Surface,
    centre: Tensor,
    rays: Tensor,
    pixels: tuple[Tensor, Tensor],
) -> tuple[Tensor, Tensor]:
    """Return the colour and depth of some pixels.

    Args:
        views: at least two.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (N, 3).
        pixels: their rows and columns, (N,) each.

    Returns:
        RGB, (N, 3), and depth, (N,), in the network's units of length.
    """
    near, far = (bound[pixels][:, None] for bound in (surface.near, surface.far))
    depths = near + (far - near) * torch.linspace(0, 1, SAMPLES)  # (N, S)
    points_world = (centre + depths[..., None] * rays[:, None]).reshape(-1, 3)
    view_features = torch.stack([view.look_up(points_world) for view in views], dim=1)
    directions = torch.stack(
        [ray_changes(points_world, view.centre, centre) for view in views], dim=1
    )
    colours, density = networks.nerf_1(
        _fine_voxels(surface, pixels, depths), view_features, directions
    )
    return composite(colours.view(-1, SAMPLES, 3), density.view(-1, SAMPLES).float(), depths)


def composite(colours: Tensor, density: Tensor, depths: Tensor) -> tuple[Tensor, Tensor]:
    """Return the colours (N, S, 3), front to back, and expected depth (N,) of samples with density
    (N, S) at depths (N, S).

    Reading:
        Depth is the mean under the softmax of the samples' shares, as in the authors' code.
    """
    shares = opacity_shares(density)
    return (shares[..., None] * colours).sum(dim=1), (torch.softmax(shares, dim=1) * depths).sum(
        dim=1
    )


def _fine_voxels(surface: Surface, pixels: tuple[Tensor, Tensor], depths: Tensor) -> Tensor:
    """Return the features of the fine volume at the samples, (N * S, 8)."""
    height, width = surface.near.shape
    first, last = surface.first[pixels][:, None], surface.last[pixels][:, None]
    rows, columns = (index[:, None].expand_as(depths) for index in pixels)
    places = torch.stack(
        [columns / (width - 1), rows / (height - 1), (depths - first) / (last - first)], dim=-1
    )
    places = 2 * places.view(1, 1, 1, -1, 3) - 1
    sampled = functional.grid_sample(
        surface.features[None], places, padding_mode="zeros", align_corners=True
    )
    return sampled[0, :, 0, 0].T


def render_surface(
    networks: Networks,
    views: list[SeenView],
    surface: Surface,
    target: Camera,
    unit: float,
    pixels_per_chunk: int = PIXELS_AT_ONCE,
) -> tuple[Tensor, Tensor]:
    """Return the RGB (3, H, W) and depth (H, W) in world units, by N pixels at once.

    Gradients reach the networks' parameters.
    """
    centre = torch.as_tensor(target.centre * unit).float()
    rays = torch.as_tensor(target.rays().reshape(-1, 3)).float()
    parts = []
    for chunk in torch.arange(len(rays)).split(pixels_per_chunk):
        pixels = torch.div(chunk, target.width, rounding_mode="floor"), chunk % target.width
        parts.append(render_pixels(networks, views, surface, centre, rays[chunk], pixels))
    image = torch.cat([colours for colours, _ in parts]).T.reshape(3, target.height, target.width)
    return image, torch.cat([depths for _, depths in parts]).view(
        target.height, target.width
    ) / unit


def coarse_views(views: Sequence[SeenView]) -> list[SeenView]:
    """Return the views at a quarter of their size: the features of that level, and the mean colour
    of each 4 x 4 pixels.
    """
    small = []
    for view in views:
        colours = functional.interpolate(
            view.maps[-3:][None],
            scale_factor=1 / COARSE_FACTOR,
            mode="bilinear",
            align_corners=True,
        )[0]
        K = view.K.copy()
        K[:2] /= COARSE_FACTOR  # as the volumes: pixel (0, 0) is the same place at every scale
        small.append(replace(view, maps=torch.cat([view.levels[0], colours]), K=K))
    return small


def render_coarsely(
    networks: Networks,
    views: Sequence[SeenView],
    surface: CoarseSurface,
    centre: Tensor,
    rays: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the colour and depth of each fourth pixel of every fourth row.

    Args:
        views: as `coarse_views` gives them.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (H / 4, W / 4,
            3).

    Returns:
        RGB, (N, 3), and depth, (N,), row by row.
    """
    height, width = rays.shape[:2]
    near, far = (bound[:height, :width].reshape(-1, 1) for bound in surface.range_at(2))
    depths = near + (far - near) * torch.linspace(0, 1, COARSE_SAMPLES)  # (N, S)
    points_world = (centre + depths[..., None] * rays.reshape(-1, 1, 3)).reshape(-1, 3)
    view_features = torch.stack([view.look_up(points_world) for view in views], dim=1)
    directions = torch.stack(
        [ray_changes(points_world, view.centre, centre) for view in views], dim=1
    )
    colours, density = networks.nerf_0(
        _coarse_voxels(surface, depths, height, width), view_features, directions
    )
    return composite(
        colours.view(-1, COARSE_SAMPLES, 3), density.view(-1, COARSE_SAMPLES).float(), depths
    )


def _coarse_voxels(surface: CoarseSurface, depths: Tensor, height: int, width: int) -> Tensor:
    """Return the features of the coarse volume at the samples (N, S), (N * S, 8)."""
    # index of the last pixel, padded ones included
    last_pixels = (2 * side - 1 for side in surface.mean.shape)
    sides = (
        2 * torch.arange(side) / last - 1
        for side, last in zip((height, width), last_pixels, strict=True)
    )
    rows, columns = torch.meshgrid(*sides, indexing="ij")
    share = (1 / depths - 1 / surface.near) / (1 / surface.far - 1 / surface.near)
    across, down = (index.reshape(-1, 1).expand_as(depths) for index in (columns, rows))
    places = torch.stack([across, down, 2 * share - 1], dim=-1).view(1, 1, 1, -1, 3)
    sampled = functional.grid_sample(
        surface.features[None], places, padding_mode="zeros", align_corners=True
    )
    return sampled[0, :, 0, 0].T
