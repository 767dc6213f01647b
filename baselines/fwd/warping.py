"""One source view carried into the target: its points, what each of them knows, and where they are seen."""

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.baselines.fwd.half_size import HalfView
from ggvs_eval.baselines.fwd.network import FwdNetwork, direction_change
from ggvs_eval.baselines.fwd.point_splat import POINTS_PER_PIXEL, PointSplat, splat_points
from ggvs_eval.camera import Camera


def warp_view(
    network: FwdNetwork, view: HalfView, target: Camera, near: float, smallest: float, count: int = POINTS_PER_PIXEL
) -> PointSplat:
    """Features of a view as the target sees them; gradients reach the network's parameters.

    Args:
        network: gives features, and completes depth if it can.
        view: the source at half its size.
        target: the camera to render, at half its size.
        near: points at or before this depth in the target are left out, world units.
        smallest: smallest depth of the scene seen from any source, world units.
        count: most points per pixel.

    Reading:
        Directions are taken in the target camera's frame, so that the world's axes do not matter, and depth enters the completion
        as a share of the largest inverse depth, 1 / `smallest`, so that its unit does not matter.
    """
    images = torch.as_tensor(view.image).permute(2, 0, 1)[None].contiguous()
    depth = _completed(network, images, torch.as_tensor(view.depth), smallest).flatten()
    rays, centre = _rays(view.camera, target)
    points = centre + torch.where(depth > 0, depth, torch.ones(()))[:, None] * rays  # (N, 3)
    directions = direction_change(rays, points).float().T.view(1, -1, *view.depth.shape)
    features = network.view_features(images, directions)[0].flatten(1).T.float()  # (N, width)
    known = torch.nonzero(depth > 0)[:, 0]
    return splat_points(points[known], features[known], target, near, count=count)


def _completed(network: FwdNetwork, images: Tensor, depth: Tensor, smallest: float) -> Tensor:
    """Depth (H, W) after the completion, if the network has one; world units, 0 where unknown."""
    if network.completion is None:
        return depth
    share = torch.where(depth > 0, smallest / depth, torch.zeros(())).clamp(max=1)
    completed: Tensor = smallest / network.completion(images, share[None, None])[0, 0]
    return completed


def _rays(camera: Camera, target: Camera) -> tuple[Tensor, Tensor]:
    """Each pixel's ray at depth 1, (H * W, 3), and the camera's centre, (3,), in the target camera, float64."""
    rays = camera.rays().reshape(-1, 3) @ target.rotation.T
    return torch.as_tensor(rays), torch.as_tensor(np.array(target.rotation @ camera.centre + target.translation))
