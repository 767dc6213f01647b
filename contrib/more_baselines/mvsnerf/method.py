"""MVSNeRF as a method: each instant from three of its source frames, by the networks that its
authors trained.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.baselines.ray_samples import opacity_shares
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.contrib.more_baselines.mvsnerf.network import (
    VIEWS,
    Networks,
    RadianceNetwork,
    load_mvsnerf,
)
from ggvs_eval.contrib.more_baselines.mvsnerf.volume import Volume, encode_volume
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering

SAMPLES = 128  # per ray
NEAR_MARGIN, FAR_MARGIN = 0.8, 1.2  # of the depths that cameras give
# on a CPU as many as its cache holds: 1,024 take three times as long
RAYS_AT_ONCE, RAYS_AT_ONCE_ON_GPU = 2**5, 2**14


class MvsNerf:
    """MVSNeRF (Chen et al., ICCV 2021), not fine-tuned.

    Depth maps are not used, nothing is remembered.

    Args:
        weights: the authors' checkpoint, see `load_mvsnerf`.
        rays_per_chunk: rays that pass through the network together; by default as many as suit the
            device.
        device: where the networks compute, see `compute_device`.

    Raises:
        DeviceError: no such device here.
        WeightsError: the weights cannot be used.

    Reading:
        The network is of three views: the nearest three are taken, the nearest is the reference.
        Depths are searched from 0.8 times the nearest to 1.2 times the farthest of their cameras
        and the target's, the margins of the authors' loader of real scenes, at even steps of depth.
        A point finds its place in the volume by the reference's own intrinsics, as in their
        training; their rendering script takes the target's, which are the same in their data. Sides
        are padded to multiples of 32 at the right and at the bottom by repeating the border. The
        authors' pixel centres are at whole numbers; principal points are moved by half a pixel.
    """

    def __init__(
        self, weights: Path, rays_per_chunk: int | None = None, device: str = "cpu"
    ) -> None:
        self._device = compute_device(device)
        self._networks = load_mvsnerf(weights).to(self._device)
        self._rays_per_chunk = rays_per_chunk or (
            RAYS_AT_ONCE_ON_GPU if self._device.type == "cuda" else RAYS_AT_ONCE
        )

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant; nothing is remembered.

        Raises:
            RenderError: fewer than three source views.
        """
        if len(instant.sources) < VIEWS:
            raise RenderError(
                f"MVSNeRF wants at least {VIEWS} source views, got {len(instant.sources)}; raise k "
                f"in the protocol"
            )
        instant = replace(instant, sources=instant.sources[:VIEWS])
        nearest, farthest = instant.depth_range
        started = clock_s(self._device)
        with rendering_on(self._device):
            volume = encode_volume(
                self._networks.network_mvs,
                instant.sources,
                NEAR_MARGIN * nearest,
                FAR_MARGIN * farthest,
            )
            volume_end_s = clock_s(self._device)
            image, depth = render_volume(
                self._networks, volume, instant.target, self._rays_per_chunk
            )
        seconds = {"volume": volume_end_s - started, "rays": clock_s(self._device) - volume_end_s}
        return Rendering(image.clamp(0, 1).numpy(force=True), depth.numpy(force=True), seconds)


def render_volume(
    networks: Networks, volume: Volume, target: Camera, rays_per_chunk: int
) -> tuple[Tensor, Tensor]:
    """Return the RGB (H, W, 3) and depth (H, W) in world units, by N rays at once."""
    centre = torch.as_tensor(target.centre).float()
    rays = torch.as_tensor(target.rays().reshape(-1, 3)).float()
    parts = [
        render_rays(networks.network_fn.nerf, volume, centre, chunk)
        for chunk in rays.split(rays_per_chunk)
    ]
    image, depth = (torch.cat(values) for values in zip(*parts, strict=True))
    return image.view(target.height, target.width, 3), depth.view(target.height, target.width)


def render_rays(
    network: RadianceNetwork, volume: Volume, centre: Tensor, rays: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the colour and depth of rays.

    Args:
        network: the trained one.
        volume: of the sources.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (N, 3).

    Returns:
        RGB, (N, 3), and expected depth, (N,), world units, smaller where rays pass through
        everything.
    """
    depths = torch.linspace(volume.near, volume.far, SAMPLES)
    points_world = (centre + depths[:, None] * rays[:, None]).reshape(-1, 3)
    to_reference = torch.as_tensor(volume.cameras[0].rotation.astype(np.float32))
    directions = (rays / rays.norm(dim=-1, keepdim=True)) @ to_reference.T
    places = volume.places(points_world)
    features = torch.cat([volume.look_up(places), volume.colours(points_world)], dim=-1)
    colours, density = network(places, features, directions.repeat_interleave(SAMPLES, dim=0))
    return composite(colours.view(-1, SAMPLES, 3), density.view(-1, SAMPLES), depths)


def composite(colours: Tensor, density: Tensor, depths: Tensor) -> tuple[Tensor, Tensor]:
    """Colours (N, S, 3), front to back, and depths (S,) of samples with density (N, S), each
    weighted by its share of the ray.
    """
    shares = opacity_shares(density)
    return (shares[..., None] * colours).sum(dim=1), shares @ depths
