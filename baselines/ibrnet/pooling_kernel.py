"""The ray network without gradients, compiled: what the views show and say of each sample, and the attention along rays."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ggvs_eval import kernels
from ggvs_eval.baselines.ibrnet.ray_network import SEEN, RayNetwork, positions
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
    norm = network.ray_attention.layer_norm
    colours, density = _core.pool_views(
        packed_layers(network),
        np.stack([norm.weight.detach().numpy(), norm.bias.detach().numpy()]),
        abs(float(network.s)),
        seen,
        centre.numpy(),
        rays.contiguous().numpy(),
        depths.contiguous().numpy(),
        positions(depths.shape[1])[0].numpy().astype(np.float32),
        kernels.SIMD_LEVELS.index(kernels.get_simd_level()),
    )
    return torch.as_tensor(colours), torch.as_tensor(density)


def packed_layers(network: RayNetwork) -> list[Packed]:
    """Weights (before, after) and bias (after) of the layers in the order of use, outputs filled up to a multiple of 8."""
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
        *((each.weight, None) for each in projections),
        *_linear(network.out_geometry_fc),
    )
    return [_packed(weights, bias) for weights, bias in in_order]


def _linear(part: nn.Sequential) -> list[tuple[Tensor, Tensor]]:
    """Weights and biases of its linear layers."""
    return [(layer.weight, layer.bias) for layer in part if isinstance(layer, nn.Linear)]


def _packed(weights: Tensor, bias: Tensor | None) -> Packed:
    after, before = weights.shape
    padded = -(-after // OUTPUTS) * OUTPUTS
    packed = np.zeros((before + 1, padded), np.float32)
    packed[:-1, :after] = weights.detach().T.numpy()
    if bias is not None:
        packed[-1, :after] = bias.detach().numpy()
    return packed[:-1], packed[-1]
