"""The U-Net by compiled kernels: what `UNet` says, on as many threads as there are, with equal bits for any number of them."""

import numpy as np
from torch import nn

from ggvs_eval.arrays import Map
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads
from ggvs_eval.pipelines.online.unet import UNet


def unet_outputs(unet: UNet, channels: Map) -> Map:
    """What a U-Net makes of channels (inputs, H, W): (outputs, H, W), float32.

    `UNet.forward` is what training differentiates, and defines this in the tests. Torch would need one thread for equal bits:
    its convolutions sum in another order with more.

    Raises:
        TypeError: another number of channels than the first layer takes.
    """
    from ggvs_eval.kernels import _core

    layers = [layer for block in (*unet.down, *unet.up) for layer in _layers(block)]
    last = np.ascontiguousarray(_array(unet.last, "weight")[:, :, 0, 0]), _array(unet.last, "bias")
    epsilon = next(module.eps for module in unet.modules() if isinstance(module, nn.GroupNorm))
    inputs = np.ascontiguousarray(channels, np.float32)
    return _core.unet(inputs, layers, last, epsilon, get_threads(), SIMD_LEVELS.index(get_simd_level()))


def _layers(block: nn.Module) -> list[tuple[Map, Map, Map, Map]]:
    """Weights, bias, gain and shift of a block's convolutions and the normalisations behind them."""
    convolutions = [module for module in block.modules() if isinstance(module, nn.Conv2d)]
    norms = [module for module in block.modules() if isinstance(module, nn.GroupNorm)]
    return [
        (_array(convolution, "weight"), _array(convolution, "bias"), _array(norm, "weight"), _array(norm, "bias"))
        for convolution, norm in zip(convolutions, norms, strict=True)
    ]


def _array(module: nn.Module, name: str) -> Map:
    return module.get_parameter(name).detach().float().cpu().numpy()
