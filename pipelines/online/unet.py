"""The U-Net of the blending network: in torch, which training differentiates, and by compiled kernels with equal bits."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.arrays import Map
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads
from ggvs_eval.pipelines.online.packed_layers import packed_once, parameter_map

LEVELS = 4
SIZE_MULTIPLE = 2**LEVELS
LEAST_SIZE_PX = 2 * SIZE_MULTIPLE  # the coarsest level must be two cells wide, or there is nothing to reflect


class UNet(nn.Module):
    """Four levels of two convolutions each, a bottleneck, and back again with skips.

    Args:
        inputs: channels.
        outputs: channels, without a final activation.
        width: channels of the first level; every further level doubles them, the bottleneck has 16 times as many.

    Reading:
        The paper says "four-layer U-Net" and gives no width. With 32 channels the multiplications per frame fit its timings; its
        blocks are taken after common practice for depth fusion: reflection padding and one normalisation group.
    """

    def __init__(self, inputs: int, outputs: int, width: int) -> None:
        super().__init__()
        widths = [width << level for level in range(LEVELS + 1)]
        befores = [inputs, *widths[:-1]]
        self.down = nn.ModuleList(_block(before, after) for before, after in zip(befores, widths, strict=True))
        self.up = nn.ModuleList(_block(3 * each, each) for each in reversed(widths[:-1]))
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.last = nn.Conv2d(width, outputs, 1)

    def forward(self, features: Tensor) -> Tensor:
        """Channels in, (B, inputs, H, W), to channels out, (B, outputs, H, W); any size of at least one pixel."""
        height, width = features.shape[2:]
        added = (*margins(width), *margins(height))
        features = functional.pad(features, added, mode="replicate")
        skips: list[Tensor] = []
        for level, block in enumerate(self.down):
            features = block(self.pool(features) if level else features)
            skips.append(features)
        skips.pop()  # the bottleneck
        for block in self.up:
            enlarged = functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
            features = block(torch.cat([skips.pop(), enlarged], dim=1))
        return self.last(features[..., added[2] : added[2] + height, added[0] : added[0] + width])


def _block(before: int, after: int) -> nn.Sequential:
    """Two times padding by reflection, 3 x 3 convolution, normalisation over all channels and pixels, ReLU."""
    layers: list[nn.Module] = []
    for channels in (before, after):
        layers.append(nn.Conv2d(channels, after, 3, padding=1, padding_mode="reflect"))
        layers.append(nn.GroupNorm(1, after))
        layers.append(nn.ReLU(inplace=True))
    return nn.Sequential(*layers)


def margins(size: int) -> tuple[int, int]:
    """Pixels to add before and behind a side, so that every level divides it."""
    missing = max(LEAST_SIZE_PX - size, -size % SIZE_MULTIPLE)
    return missing // 2, missing - missing // 2


def unet_outputs(unet: UNet, channels: Map, given: NDArray[np.intp] | None = None) -> Map:
    """Evaluate a U-Net on channels (inputs, H, W): (outputs, H, W), float32.

    Args:
        unet: its weights.
        channels: its inputs, or some of them.
        given: numbers of the inputs that `channels` are, ascending, all unless given. The others are 0: sums are the same bits
            without them.

    `UNet.forward` is what training differentiates, and defines this in the tests. Torch would need one thread for equal bits:
    its convolutions sum in another order with more.

    Raises:
        TypeError: another number of channels than the first layer takes.
    """
    from ggvs_eval.kernels import _core

    chosen = None if given is None else tuple(given.tolist())
    layers = packed_once(unet, chosen, lambda: _layers(unet, given))
    last = np.ascontiguousarray(parameter_map(unet.last, "weight")[:, :, 0, 0]), parameter_map(unet.last, "bias")
    epsilon = next(module.eps for module in unet.modules() if isinstance(module, nn.GroupNorm))
    inputs = np.ascontiguousarray(channels, np.float32)
    return _core.unet(inputs, layers, last, epsilon, get_threads(), SIMD_LEVELS.index(get_simd_level()))


def _layers(unet: UNet, given: NDArray[np.intp] | None) -> list[tuple[Map, Map, Map, Map]]:
    """Packed filters and bias, gain and shift of all convolutions and the normalisations behind them, in order of use."""
    from ggvs_eval.kernels import _core

    modules = [module for block in (*unet.down, *unet.up) for module in block.modules()]
    convolutions = [module for module in modules if isinstance(module, nn.Conv2d)]
    norms = [module for module in modules if isinstance(module, nn.GroupNorm)]
    layers: list[tuple[Map, Map, Map, Map]] = []
    for convolution, norm in zip(convolutions, norms, strict=True):
        weights, bias = parameter_map(convolution, "weight"), parameter_map(convolution, "bias")
        if given is not None and not layers:
            weights = weights[:, given]
        layers.append((*_core.pack_filters(weights, bias), parameter_map(norm, "weight"), parameter_map(norm, "bias")))
    return layers
