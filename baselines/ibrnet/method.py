"""IBRNet as a method: each instant from its own source frames, by the network that its authors
trained.
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import torch
from torch import Tensor

from ggvs_eval import kernels
from ggvs_eval.baselines.ibrnet.network import SMALLEST_SIDE_PX, load_ibrnet
from ggvs_eval.baselines.ibrnet.rendering import (
    SeenView,
    depth_range,
    rays_at_once,
    render_rays,
    see,
)
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering

FEWEST_VIEWS = 2  # a sample that one view sees cannot be compared with anything


class IBRNet:
    """IBRNet (Wang et al., CVPR 2021), 64 coarse and 64 added samples per ray.

    Depth maps are not used, nothing is remembered.

    Args:
        weights: the authors' checkpoint, see `load_ibrnet`.
        rays_per_chunk: rays that pass through the networks together; by default as many as suit the
            device.

    Reading:
        Depths are searched from 0.9 times the nearest to 1.6 times the farthest of the cameras of
        the instant, the margins of the authors' loader of real scenes, evenly in inverse depth, as
        their evaluation does. The authors' pixel centres are at whole numbers; principal points are
        moved by half a pixel.
    """

    def __init__(
        self, weights: Path, rays_per_chunk: int | None = None, device: str = "cpu"
    ) -> None:
        self._device = compute_device(device)
        self._networks = load_ibrnet(weights).to(self._device)
        self._rays_per_chunk = rays_per_chunk

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant; nothing is remembered."""
        _check(instant)
        started = clock_s(self._device)
        with rendering_on(self._device):
            views = see(self._networks, instant.sources)
            features_end_s = clock_s(self._device)
            image, depth = self._render(instant, views)
        seconds = {
            "features": features_end_s - started,
            "rays": clock_s(self._device) - features_end_s,
        }
        return Rendering(image.numpy(force=True), depth.numpy(force=True), seconds)

    def _render(self, instant: Instant, views: list[SeenView]) -> tuple[Tensor, Tensor]:
        """Return the RGB (H, W, 3) and depth (H, W)."""
        target = instant.target
        near, far = depth_range(instant)
        centre = torch.as_tensor(target.centre).float()
        rays = torch.as_tensor(target.rays().reshape(-1, 3)).float()
        together = self._rays_per_chunk or rays_at_once(
            len(views), self._networks.config.samples, self._device
        )
        chunks = rays.split(together)

        def render(chunk: Tensor) -> tuple[Tensor, Tensor]:
            with torch.inference_mode():  # holds for the thread that enters it
                return render_rays(self._networks, views, centre, chunk, near, far)

        if self._device.type == "cpu":
            # whole chunks, so that their number moves no bit
            with ThreadPoolExecutor(kernels.get_threads()) as pool:
                parts = list(pool.map(render, chunks))
        else:  # what is made there is made so in the thread that asked for it alone
            parts = [render(chunk) for chunk in chunks]
        image = torch.cat([colours for colours, _ in parts]).clamp(0, 1)
        depth = torch.cat([depths for _, depths in parts])
        return image.view(target.height, target.width, 3), depth.view(target.height, target.width)


def _check(instant: Instant) -> None:
    if len(instant.sources) < FEWEST_VIEWS:
        raise RenderError(
            f"IBRNet wants at least {FEWEST_VIEWS} source views, got {len(instant.sources)}; raise "
            f"k in the protocol"
        )
    for source in instant.sources:
        if min(source.image.shape[:2]) < SMALLEST_SIDE_PX:
            height, width = source.image.shape[:2]
            raise RenderError(
                f"camera {source.camera.name}: IBRNet wants images of at least {SMALLEST_SIDE_PX} "
                f"pixels a side, got {width} x {height}; render at a larger size"
            )
