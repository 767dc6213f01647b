"""FWD as a method: each instant from its own source frames and the depth that comes with them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ggvs_eval.baselines.fwd.network import load_network
from ggvs_eval.baselines.fwd.rendering import decode_views, warp_views
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering


@dataclass(frozen=True)
class Fwd:
    """FWD-D (Cao et al. 2022), the variant that is given depth; nothing is remembered from instant to instant.

    Attributes:
        weights: file of its weights, see `load_network`.
        points_per_pixel: most points that a view blends at a pixel; by default as many as the weights were trained with.
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
        """Synthesise one instant."""
        device = compute_device(self.device)
        network = load_network(self.weights, device)
        with rendering_on(device):
            started = clock_s(device)
            views = warp_views(network, instant, self.points_per_pixel)
            warped = clock_s(device)
            image = decode_views(network, instant, views)
        rendered = np.ascontiguousarray(image.permute(1, 2, 0).numpy(force=True))
        return Rendering(rendered, None, {"warp": warped - started, "decode": clock_s(device) - warped})
