"""FWD with given depth behind the `Method` interface: every instant by itself, from any number of views."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.baselines.fwd.half_size import halve, halved_camera
from ggvs_eval.baselines.fwd.network import FwdNetwork
from ggvs_eval.baselines.fwd.point_splat import PointSplat
from ggvs_eval.baselines.fwd.warping import warp_view
from ggvs_eval.baselines.fwd.weights import load_network
from ggvs_eval.baselines.gaussians import near_plane
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering

SIZE_MULTIPLE = 4  # the decoder halves half the size once more


@dataclass(frozen=True)
class Fwd:
    """FWD-D (Cao et al. 2022), the variant that is given depth; nothing is remembered from instant to instant.

    Attributes:
        weights: file of its weights, see `load_network`.
        points_per_pixel: most points that a view blends at a pixel; by default as many as the weights were trained with.
        device: where the network computes, see `compute_device`.
    """

    weights: Path
    points_per_pixel: int | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse options that mean nothing."""
        if self.points_per_pixel is not None and self.points_per_pixel < 1:
            raise RenderError(f"FWD: wanted at least one point per pixel, got {self.points_per_pixel}")
        compute_device(self.device)

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant.

        Raises:
            WeightsError: no usable weights.
        """
        device = compute_device(self.device)
        network = load_network(self.weights, device)
        with rendering_on(device):
            started = clock_s(device)
            views = warp_views(network, instant, self.points_per_pixel)
            warped = clock_s(device)
            image = decode_views(network, instant, views)
        rendered = np.ascontiguousarray(image.permute(1, 2, 0).numpy(force=True))
        return Rendering(rendered, None, {"warp": warped - started, "decode": clock_s(device) - warped})


def warp_views(network: FwdNetwork, instant: Instant, points_per_pixel: int | None = None) -> list[PointSplat]:
    """Features of each source as the target sees them at half its size; gradients reach the network's parameters."""
    target = halved_camera(instant.target, SIZE_MULTIPLE)
    near = near_plane(instant)
    smallest = min(source.camera.near for source in instant.sources)
    count = points_per_pixel or network.config.points_per_pixel
    return [warp_view(network, halve(source), target, near, smallest, count) for source in instant.sources]


def decode_views(network: FwdNetwork, instant: Instant, views: Sequence[PointSplat]) -> Tensor:
    """The target view, (3, H, W) in [0, 1]."""
    decoded = network.decode(torch.stack([view.features for view in views]), torch.stack([view.alpha for view in views]))
    return decoded[:, : instant.target.height, : instant.target.width].float() / 2 + 0.5
