"""ENeRF as a method: each instant from its own source frames, by the network that its authors
trained.
"""

from pathlib import Path

import numpy as np

from ggvs_eval.baselines.enerf.network import load_enerf
from ggvs_eval.baselines.enerf.rendering import (
    PIXELS_AT_ONCE,
    find_surface,
    render_surface,
    target_grid,
)
from ggvs_eval.baselines.enerf.views import TRAINED_NEAR, see
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering

PIXELS_AT_ONCE_ON_GPU = 2**17  # some 2 GB; a few large pieces of work keep it busy
FEWEST_VIEWS = 2  # disagreement of one view is nothing


class ENeRF:
    """ENeRF (Lin et al., SIGGRAPH Asia 2022), generic network.

    Depth maps are not used, nothing is remembered.

    Args:
        weights: the authors' checkpoint, see `load_enerf`.
        coarse_planes: planes of the coarse volume, a multiple of 4; by default those of the
            weights' configuration: 64 in the published training, 32 in the authors' runs on real
            scenes and in this package's compact one.
        pixels_per_chunk: pixels that are rendered together; by default as many as suit the device.

    Reading:
        Depths are searched between the nearest and the farthest of the cameras of the instant.
        Lengths are scaled so that the nearest depth is that of the training, because the network's
        smallest deviations are lengths. Sides are padded to multiples of 32 at the right and at the
        bottom, sources by repeating their border. The authors' pixel centres are at whole numbers;
        principal points are moved by half a pixel.
    """

    def __init__(
        self,
        weights: Path,
        coarse_planes: int | None = None,
        pixels_per_chunk: int | None = None,
        device: str = "cpu",
    ) -> None:
        if coarse_planes is not None and (coarse_planes < 4 or coarse_planes % 4):
            raise RenderError(
                f"ENeRF's coarse volume is halved twice; wanted planes in multiples of 4, got "
                f"{coarse_planes}"
            )
        self._device = compute_device(device)
        self._networks = load_enerf(weights).to(self._device)
        self._coarse_planes = coarse_planes or self._networks.coarse_planes
        suitable = PIXELS_AT_ONCE_ON_GPU if self._device.type == "cuda" else PIXELS_AT_ONCE
        self._pixels_per_chunk = pixels_per_chunk or suitable

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant; nothing is remembered."""
        if len(instant.sources) < FEWEST_VIEWS:
            raise RenderError(
                f"ENeRF wants at least {FEWEST_VIEWS} source views, got {len(instant.sources)}; "
                f"raise k in the protocol"
            )
        near, far = instant.depth_range
        unit = TRAINED_NEAR / near
        started = clock_s(self._device)
        with rendering_on(self._device):
            views = [see(self._networks.feature_net, source, unit) for source in instant.sources]
            features_end_s = clock_s(self._device)
            grid = target_grid(instant.target, unit)
            surface = find_surface(
                self._networks, views, grid, near * unit, far * unit, self._coarse_planes
            )
            volumes_end_s = clock_s(self._device)
            image, depth = render_surface(
                self._networks, views, surface, instant.target, unit, self._pixels_per_chunk
            )
        rendered = np.ascontiguousarray(image.permute(1, 2, 0).clamp(0, 1).numpy(force=True))
        seconds = {
            "features": features_end_s - started,
            "volumes": volumes_end_s - features_end_s,
            "rays": clock_s(self._device) - volumes_end_s,
        }
        return Rendering(rendered, depth.numpy(force=True), seconds)
