"""The ray network without gradients: what the views show and say of each sample in one compiled pass, then the attention."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval import kernels
from ggvs_eval.baselines.ibrnet.ray_network import SEEN, RayNetwork
from ggvs_eval.baselines.ibrnet.views import Pass, SeenView

Packed = tuple[NDArray[np.float32], NDArray[np.float32]]
OUTPUTS = 8  # of a layer that the kernel sums side by side


def shade_by_kernel(
    network: RayNetwork, views: Sequence[SeenView], of_pass: Pass, centre: Tensor, rays: Tensor, depths: Tensor
) -> tuple[Tensor, Tensor]:
    """Colour and density of samples, as `RayNetwork.forward` computes them from `SeenView.look_up` and `directions`.

    Args:
        network: of the pass.
        views: at least two.
        of_pass: whose features the views are looked up in.
        centre: of the target camera, (3,).
        rays: (R, 3).
        depths: (R, S).

    Returns:
        RGB, (R, S, 3), and density, (R, S).
    """
    from ggvs_eval.kernels import _core

    seen = [(view.pixels["image"], view.pixels[of_pass], view.projection.numpy(), view.centre.numpy()) for view in views]
    colours, features, seen_by = _core.pool_views(
        packed_layers(network),
        abs(float(network.s)),
        seen,
        centre.numpy(),
        rays.contiguous().numpy(),
        depths.contiguous().numpy(),
        kernels.LEVELS.index(kernels.get_level()),
    )
    with torch.no_grad():
        density = network.density(torch.from_numpy(features), torch.from_numpy(seen_by)[..., None])
    return torch.from_numpy(colours), density.float()


def packed_layers(network: RayNetwork) -> list[Packed]:
    """Weights (before, after) and bias (after) of the layers in the order of use, outputs filled up to a multiple of 8."""
    first = network.base_fc.get_parameter("0.weight")
    layers = [(network.base_fc.get_parameter("2.weight"), network.base_fc.get_parameter("2.bias"))]
    shared = (first[:, : 2 * SEEN], network.base_fc.get_parameter("0.bias"))
    own = (first[:, 2 * SEEN :], torch.zeros(len(first)))
    before, after = (
        [(part.get_parameter(f"{at}.weight"), part.get_parameter(f"{at}.bias")) for part, ats in parts for at in ats]
        for parts in (
            [(network.ray_dir_fc, (0, 2))],
            [(network.vis_fc, (0, 2)), (network.vis_fc2, (0, 2)), (network.geometry_fc, (0, 2)), (network.rgb_fc, (0, 2, 4))],
        )
    )
    return [_packed(weights, bias) for weights, bias in (*before, shared, own, *layers, *after)]


def _packed(weights: Tensor, bias: Tensor) -> Packed:
    after, before = weights.shape
    padded = -(-after // OUTPUTS) * OUTPUTS
    packed = np.zeros((before + 1, padded), np.float32)
    packed[:-1, :after] = weights.detach().T.numpy()
    packed[-1, :after] = bias.detach().numpy()
    return packed[:-1], packed[-1]
