"""Rays of the target through the networks: places of samples, a coarse pass, a fine pass where it
found something.

Source views are looked up at points of the world.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ggvs_eval import kernels
from ggvs_eval.baselines.ibrnet.network import SEEN, Networks, RayNetwork, positions
from ggvs_eval.baselines.ray_samples import opacity_shares, ray_changes
from ggvs_eval.camera import Camera
from ggvs_eval.method import Instant, SourceView

Pixels = NDArray[np.float32]
Pass = Literal["coarse", "fine"]
FARTHEST_PX = 1e6
BILINEAR, ZEROS = 0, 0  # torch's numbers of interpolation and padding
NEARER, FARTHER = 0.9, 1.6  # margins that the authors put around the depths of a real scene
SMALLEST_SHARE = 1e-5  # of an interval of depths in the placement of the second samples
# Samples times views that pass through the networks together: some 0.1 GB, and fast in the caches;
# on a GPU some 2 GB.
ROWS_AT_ONCE = {"cpu": 2**16, "cuda": 2**20}
OUTPUTS = 8  # of a layer that the kernel sums side by side
# colours (R, 3), share of each sample in them (R, S), depths of the samples (R, S)
Shaded = tuple[Tensor, Tensor, Tensor]
# weights (before, after) and bias (after) of a layer
Packed = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True)
class SeenView:
    """One source view, ready to be looked up.

    Attributes:
        image: RGB in [0, 1], (3, H, W).
        coarse: features for the coarse pass, (32, h, w).
        fine: features for the fine pass, (32, h, w).
        projection: world to image, pixel centres at whole numbers, (3, 4).
        centre: of the camera in the world, (3,).
    """

    image: Tensor
    coarse: Tensor
    fine: Tensor
    projection: Tensor
    centre: Tensor

    @cached_property
    def pixels(self) -> dict[str, Pixels]:
        """``image``, ``coarse`` and ``fine`` with the channels of a pixel side by side, (H, W, C),
        as kernels read them.
        """
        maps = {"image": self.image, "coarse": self.coarse, "fine": self.fine}
        return {
            name: np.ascontiguousarray(tensor.permute(1, 2, 0).numpy(), np.float32)
            for name, tensor in maps.items()
        }

    def look_up(self, points_world: Tensor, of_pass: Pass) -> tuple[Tensor, Tensor]:
        """Return the colour and features at points, and whether the image shows them.

        Args:
            points_world: (..., 3).

        Returns:
            (..., 35), linear between pixels, and (..., 1) bool.
        """
        projected = points_world @ self.projection[:, :3].T + self.projection[:, 3]
        depth = projected[..., 2:]
        uv = (projected[..., :2] / depth.clamp(min=1e-8)).clamp(-FARTHEST_PX, FARTHEST_PX)
        largest = uv.new_tensor([self.image.shape[2] - 1, self.image.shape[1] - 1])
        inside = ((uv >= 0) & (uv <= largest)).all(dim=-1, keepdim=True)
        places = 2 * uv / largest - 1  # of the corners' centres: -1 and 1, at any size
        features = self.coarse if of_pass == "coarse" else self.fine
        return torch.cat(
            [_sample(self.image, places), _sample(features, places)], dim=-1
        ), inside & (depth > 0)


def projection_of(camera: Camera) -> Tensor:
    """Return the transform of world to image with pixel centres at whole numbers, (3, 4)."""
    return torch.as_tensor(
        np.ascontiguousarray(camera.K_opencv @ camera.world_to_camera[:3])
    ).float()


def _sample(channels: Tensor, places: Tensor) -> Tensor:
    """Return the bilinear lookup of (C, H, W) at (..., 2) in [-1, 1], 0 outside, (..., C)."""
    flat = places.reshape(1, 1, -1, 2)
    # The kernel behind `functional.grid_sample`, which on a GPU would take cuDNN's: that refuses
    # some numbers of places.
    sampled = torch.grid_sampler_2d(channels[None], flat, BILINEAR, ZEROS, True)
    return sampled[0, :, 0].T.reshape(*places.shape[:-1], channels.shape[0])


def see(networks: Networks, sources: Sequence[SourceView]) -> list[SeenView]:
    """Return the source views, ready to be looked up."""
    views = []
    for source in sources:
        image = torch.as_tensor(source.image).permute(2, 0, 1).float() / 255
        coarse, fine = networks.feature_net(image[None])
        centre = torch.as_tensor(source.camera.centre).float()
        views.append(
            SeenView(
                image=image,
                coarse=coarse[0].float(),
                fine=fine[0].float(),
                projection=projection_of(source.camera),
                centre=centre,
            )
        )
    return views


def render_rays(
    networks: Networks,
    views: Sequence[SeenView],
    centre: Tensor,
    rays: Tensor,
    near: float,
    far: float,
) -> tuple[Tensor, Tensor]:
    """Return the colour and depth of some rays.

    Args:
        views: at least two.
        centre: of the target camera in the world, (3,).
        rays: directions in the world such that centre + depth * ray has that depth, (R, 3).
        near: depth of the first sample, world units.

    Returns:
        RGB, (R, 3), and expected depth, (R,), 0 if a ray met less than half an opaque surface.
    """
    _, fine = render_passes(networks, views, centre, rays, near, far)
    colours, shares, depths = fine
    total = shares.sum(dim=1)
    expected = (shares * depths).sum(dim=1) / total.clamp(min=1e-10)
    return colours, torch.where(total >= 0.5, expected, 0.0)


def render_passes(
    networks: Networks,
    views: Sequence[SeenView],
    centre: Tensor,
    rays: Tensor,
    near: float,
    far: float,
) -> tuple[Tensor, Shaded]:
    """Colours (R, 3) of the coarse pass, and the fine pass; arguments as of `render_rays`.

    Gradients reach the networks.
    """
    count = networks.config.samples
    depths = coarse_depths(near, far, count).expand(rays.shape[0], -1)
    colours, density = _shade(networks.net_coarse, views, "coarse", centre, rays, depths)
    shares = opacity_shares(density)
    rough = (shares[..., None] * colours).sum(dim=1)
    depths = finer_depths(depths, shares.detach(), count)
    colours, density = _shade(networks.net_fine, views, "fine", centre, rays, depths)
    shares = opacity_shares(density)
    return rough, ((shares[..., None] * colours).sum(dim=1), shares, depths)


def rays_at_once(views: int, samples: int, device: torch.device | None = None) -> int:
    """Return the number of rays of N coarse samples that fit through the networks together on a
    device, the CPU unless given.
    """
    return max(1, ROWS_AT_ONCE[device.type if device else "cpu"] // (2 * samples * views))


def _shade(
    network: RayNetwork,
    views: Sequence[SeenView],
    of_pass: Pass,
    centre: Tensor,
    rays: Tensor,
    depths: Tensor,
) -> tuple[Tensor, Tensor]:
    """RGB (R, S, 3) and density (R, S) of the samples at the depths (R, S).

    Compiled on the CPU where no gradients are wanted.
    """
    if rays.device.type == "cpu" and not (torch.is_grad_enabled() and network.s.requires_grad):
        return shade_by_kernel(network, views, of_pass, centre, rays, depths)
    points_world = centre + depths[..., None] * rays[:, None]  # (R, S, 3)
    looked_up = [view.look_up(points_world, of_pass) for view in views]
    view_features = torch.stack([values for values, _ in looked_up], dim=2)
    visible = torch.stack([inside for _, inside in looked_up], dim=2)
    differences = torch.stack(
        [ray_changes(points_world, centre, view.centre) for view in views], dim=2
    )
    colours, density = network(view_features, differences, visible)
    return colours.float(), density.float()


def depth_range(instant: Instant) -> tuple[float, float]:
    """Return the depths between which surfaces are searched, world units."""
    near, far = instant.depth_range
    return NEARER * near, FARTHER * far


def coarse_depths(near: float, far: float, count: int) -> Tensor:
    """Return the depths from near to far, evenly spaced in inverse depth, (count,)."""
    step = (1 / far - 1 / near) / (count - 1)
    return 1 / (1 / near + torch.arange(count) * step)


def finer_depths(depths: Tensor, weights: Tensor, count: int) -> Tensor:
    """Return the depths of the first pass and as many more as asked for, drawn evenly from what it
    saw.

    Args:
        depths: of the first pass, (R, S), increasing.
        weights: share of each in its pixel's colour, (R, S).

    Returns:
        (R, S + count), increasing.

    Reading:
        The distribution is constant between the middles of neighbouring samples, in inverse depth;
        the weights of the first and the last sample are left out.
    """
    inverse = 1 / depths
    middles = (inverse[:, 1:] + inverse[:, :-1]) / 2
    added = 1 / quantiles(middles.flip(1), weights[:, 1:-1].flip(1), count)
    return torch.cat([depths, added], dim=1).sort(dim=1).values


def quantiles(edges: Tensor, weights: Tensor, count: int) -> Tensor:
    """Evenly spaced quantiles, 0 to 1, of a distribution that is constant between edges.

    Args:
        edges: (R, M + 1), increasing.
        weights: of the M intervals, (R, M); a small constant is added to each.

    Returns:
        (R, count), increasing.
    """
    shares = weights + SMALLEST_SHARE
    cumulative = torch.cumsum(shares / shares.sum(dim=1, keepdim=True), dim=1)
    cumulative = torch.cat([torch.zeros_like(cumulative[:, :1]), cumulative], dim=1)  # (R, M + 1)
    levels = (
        torch.linspace(0, 1, count, device=edges.device).expand(edges.shape[0], count).contiguous()
    )
    # (R, count), 1..M
    above = torch.searchsorted(cumulative[:, :-1].contiguous(), levels, right=True)
    below = (above - 1).clamp(min=0)
    height = cumulative.gather(1, above) - cumulative.gather(1, below)
    height = torch.where(height < SMALLEST_SHARE, 1.0, height)
    along = (levels - cumulative.gather(1, below)) / height
    return edges.gather(1, below) + along * (edges.gather(1, above) - edges.gather(1, below))


def shade_by_kernel(
    network: RayNetwork,
    views: Sequence[SeenView],
    of_pass: Pass,
    centre: Tensor,
    rays: Tensor,
    depths: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the colour and density of samples, as `RayNetwork.forward` computes them from
    `SeenView.look_up` and `ray_changes`.

    Args:
        views: at least two.
        centre: of the target camera, (3,).
        rays: (R, 3).
        depths: (R, S).

    Returns:
        RGB, (R, S, 3), and density, (R, S).
    """
    from ggvs_eval.kernels import _core

    packed_views = [
        (view.pixels["image"], view.pixels[of_pass], view.projection.numpy(), view.centre.numpy())
        for view in views
    ]
    norm = network.ray_attention.layer_norm
    colours, density = _core.pool_views(
        packed_layers(network),
        np.stack([norm.weight.detach().numpy(), norm.bias.detach().numpy()]),
        abs(float(network.s)),
        packed_views,
        centre.numpy(),
        rays.contiguous().numpy(),
        depths.contiguous().numpy(),
        positions(depths.shape[1])[0].numpy().astype(np.float32),
        kernels.SIMD_LEVELS.index(kernels.get_simd_level()),
    )
    return torch.as_tensor(colours), torch.as_tensor(density)


def packed_layers(network: RayNetwork) -> list[Packed]:
    """Weights (before, after) and bias (after) of the layers in the order of use, outputs filled up
    to a multiple of 8.
    """
    attention = network.ray_attention
    (first, bias), base = _linear(network.base_fc)
    parts = (network.vis_fc, network.vis_fc2, network.geometry_fc, network.rgb_fc)
    projections = (attention.w_qs, attention.w_ks, attention.w_vs, attention.fc)
    in_order = (
        *_linear(network.ray_dir_fc),
        (first[:, : 2 * SEEN], bias),  # for what the views share
        (first[:, 2 * SEEN :], None),  # for what is a view's own
        base,
        *(layer for part in parts for layer in _linear(part)),
        *((layer.weight, None) for layer in projections),
        *_linear(network.out_geometry_fc),
    )
    return [_packed(weights, bias) for weights, bias in in_order]


def _linear(part: nn.Sequential) -> list[tuple[Tensor, Tensor]]:
    """Return the weights and biases of its linear layers."""
    return [(layer.weight, layer.bias) for layer in part if isinstance(layer, nn.Linear)]


def _packed(weights: Tensor, bias: Tensor | None) -> Packed:
    after, before = weights.shape
    padded = -(-after // OUTPUTS) * OUTPUTS
    packed = np.zeros((before + 1, padded), np.float32)
    packed[:-1, :after] = weights.detach().T.numpy()
    if bias is not None:
        packed[-1, :after] = bias.detach().numpy()
    return packed[:-1], packed[-1]
