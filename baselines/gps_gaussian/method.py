"""GPS-Gaussian behind the `Method` interface: every instant by itself, from the nearest pair that makes a stereo pair."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.baselines.gps_gaussian.gaussians import Gaussians, join, rotation_matrices
from ggvs_eval.baselines.gps_gaussian.network import GpsGaussianNetwork, load_network
from ggvs_eval.baselines.gps_gaussian.rectification import RectifiedPair, RectifiedView, choose_pairs, rectify
from ggvs_eval.baselines.gps_gaussian.rendering import render_gaussians
from ggvs_eval.baselines.gps_gaussian.unet import GaussianMaps
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering, SourceView


@dataclass(frozen=True)
class GpsGaussian:
    """GPS-Gaussian (Zheng et al. 2024); nothing is remembered from instant to instant.

    Attributes:
        weights: file of its weights, see `load_network`.
        depth: ``own`` stereo between the two images, or the depth ``given`` with the sources; Gaussians are its own either way.
        pairs: how many pairs are rendered together; by default what the weights' configuration says, one for the authors'.
        rotations_in: what the network's rotations refer to, see `GpsGaussianOptions`, which says it where nothing is said here.
        device: where the network computes and Gaussians are rendered, see `compute_device`.

    Reading:
        The network knows metres: inverse depth goes in per metre, and scales, at most 0.01 m, come out in metres. What that is in
        the world follows from `Instant.units_per_metre`. The limit is the authors', for persons two metres away, and is kept so
        that their weights mean the same; it binds where a pixel is wider than about 2 cm: in images 480 pixels wide beyond 5 m.
        Pixels outside the rectified image are grey to the network, as the authors' masks make them, and have no Gaussian; nor do
        pixels whose disparity has the wrong sign.
    """

    weights: Path
    depth: Literal["own", "given"] = "own"
    pairs: int | None = None
    rotations_in: Literal["world", "camera"] | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse options that mean nothing."""
        frames = (None, "world", "camera")
        if self.depth not in ("own", "given") or self.rotations_in not in frames or (self.pairs is not None and self.pairs < 1):
            raise RenderError(
                "GPS-Gaussian: wanted depth own or given, rotations_in world or camera and at least one pair, got "
                f"{self.depth!r}, {self.rotations_in!r} and {self.pairs}"
            )
        compute_device(self.device)

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant.

        Raises:
            ViewRefusedError: no two of the sources make a stereo pair.
            WeightsError: no usable weights.
        """
        device = compute_device(self.device)
        network = load_network(self.weights, device)
        config = network.config
        with rendering_on(device):
            started = clock_s(device)
            gaussians = instant_gaussians(
                network, instant, self.depth, self.pairs or config.pairs, self.rotations_in or config.rotations_in
            )
            regressed = clock_s(device)
            image = render_gaussians(gaussians, instant.target, instant.near_plane)
        seconds = {"network": regressed - started, "splat": clock_s(device) - regressed}
        return Rendering(np.minimum(image.colour, np.float32(1)), image.depth, seconds)


def instant_gaussians(
    network: GpsGaussianNetwork,
    instant: Instant,
    depth: Literal["own", "given"],
    pairs: int,
    rotations_in: Literal["world", "camera"],
) -> Gaussians:
    """The Gaussians of an instant's nearest pairs; arguments as of `GpsGaussian`, gradients reach the network's parameters."""
    parts = []
    for left, right in choose_pairs(instant.target, [source.camera for source in instant.sources], pairs):
        sources = instant.sources[left], instant.sources[right]
        pair = rectify(sources[0].camera, sources[1].camera, network.config.whole)
        colours = [view.image(source) for view, source in zip(pair.views, sources, strict=True)]
        images = torch.stack([_network_image(view, image) for view, image in zip(pair.views, colours, strict=True)])
        features = network.features(images)
        inverse = _given(pair, sources) if depth == "given" else _own(pair, network.flow(features))
        per_metre = torch.as_tensor(inverse * np.float32(instant.units_per_metre))[:, None]
        maps = network.gaussians(images, per_metre, features)
        parts += [
            _of_view(view, colours[half], inverse[half], _half(maps, half), instant.units_per_metre, rotations_in)
            for half, view in enumerate(pair.views)
        ]
    return join(parts)


def _of_view(
    view: RectifiedView, image: Map, inverse: Map, maps: GaussianMaps, units_per_metre: float, rotations_in: str
) -> Gaussians:
    """The Gaussians of the pixels with known depth; maps are (C, H, W)."""
    rows, columns = np.nonzero(view.inside & (inverse > 0))
    uv = np.stack([columns, rows], axis=1).astype(np.float64) + 0.5
    centres = view.camera.unproject(uv, 1 / inverse[rows, columns].astype(np.float64))
    rotation, scale_m, opacity = (values[:, torch.as_tensor(rows), torch.as_tensor(columns)].float() for values in maps)
    axes = rotation_matrices(rotation.T)
    if rotations_in == "camera":
        axes = torch.as_tensor(view.camera.rotation.T.astype(np.float32)) @ axes
    colours = torch.as_tensor(image[rows, columns])
    return Gaussians(torch.as_tensor(centres), axes, scale_m.T * units_per_metre, opacity[0], colours)


def _network_image(view: RectifiedView, image: Map) -> Tensor:
    """(3, H, W) in [-1, 1], 0 outside."""
    return torch.as_tensor(np.where(view.inside[..., None], 2 * image - 1, np.float32(0))).permute(2, 0, 1).contiguous()


def _given(pair: RectifiedPair, sources: tuple[SourceView, SourceView]) -> Map:
    """Inverse depth of both halves from the depth that the sources come with, (2, Hc, Wc), per world unit."""
    return np.stack([view.inverse_depth(source) for view, source in zip(pair.views, sources, strict=True)])


def _own(pair: RectifiedPair, flow: Tensor) -> Map:
    """Inverse depth of both halves from the network's flow (2, 1, Hc, Wc), (2, Hc, Wc), per world unit."""
    return pair.inverse_depth(flow[:, 0].numpy(force=True))


def _half(maps: GaussianMaps, half: int) -> GaussianMaps:
    return GaussianMaps(*(values[half] for values in maps))
