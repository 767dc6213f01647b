"""U-Nets in which the views look at each other at the coarsest level; names of modules are those of the published checkpoint."""

import torch
from torch import Tensor, nn
from torch.nn import functional

GROUPS = 8  # of the normalisations
HEAD_WIDTH = 32  # channels of an attention's head; fewer where the whole has fewer


class ResidualUnit(nn.Module):
    """Two convolutions, each normalised after it, beside a shortcut."""

    def __init__(self, width_in: int, width: int) -> None:
        super().__init__()
        self.in_layers = nn.Sequential(nn.Conv2d(width_in, width, 3, padding=1), nn.GroupNorm(GROUPS, width), nn.SiLU())
        self.out_layers = nn.Sequential(nn.Conv2d(width, width, 3, padding=1), _silent(width), nn.SiLU())
        self.skip_connection = nn.Identity() if width_in == width else nn.Conv2d(width_in, width, 1)

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w) to (K, width, h, w)."""
        changed: Tensor = self.out_layers(self.in_layers(features))
        return self.skip_connection(features) + changed


class JointAttention(nn.Module):
    """Every cell of every view looks at every cell of every view."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.heads = max(width // HEAD_WIDTH, 1)
        self.qkv = nn.Conv1d(width, 3 * width, 1)
        self.proj_out = nn.Conv1d(width, width, 1)
        self.norm = _silent(width)

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w), of any number of views."""
        count, channels, height, width = features.shape
        cells = features.flatten(2)  # (K, C, h * w)
        joined = self.qkv(cells).transpose(0, 1).reshape(self.heads, 3, channels // self.heads, -1)  # heads first, then q, k, v
        query, key, value = (part.transpose(-1, -2)[None].contiguous() for part in joined.unbind(1))  # (1, heads, K * h * w, C')
        seen = functional.scaled_dot_product_attention(query, key, value)
        apart = seen[0].transpose(-1, -2).reshape(channels, count, height * width).transpose(0, 1)
        changed: Tensor = self.norm(self.proj_out(apart))
        return (cells + changed).reshape(features.shape)


class Halving(nn.Module):
    """A convolution that halves both sides."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.op = nn.Conv2d(width, width, 3, stride=2, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w) to (K, C, h / 2, w / 2)."""
        halved: Tensor = self.op(features)
        return halved


class Doubling(nn.Module):
    """Each cell four times, then a convolution."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w) to (K, C, 2 h, 2 w)."""
        doubled: Tensor = self.conv(functional.interpolate(features, scale_factor=2, mode="nearest"))
        return doubled


class UNet(nn.Module):
    """One residual unit on each level down, two on each level up.

    Args:
        levels: each after the first at half the size of that before it.
    """

    def __init__(self, width: int, levels: int) -> None:
        super().__init__()
        lowest = levels - 1
        self.input_blocks = nn.ModuleList([nn.Sequential(nn.Conv2d(width, width, 3, padding=1))])
        self.output_blocks = nn.ModuleList()
        for level in range(levels):
            attention = [JointAttention(width)] if level == lowest else []
            self.input_blocks.append(nn.Sequential(ResidualUnit(width, width), *attention))
            if level != lowest:
                self.input_blocks.append(nn.Sequential(Halving(width)))
        self.middle_block = nn.Sequential(ResidualUnit(width, width), nn.Identity(), ResidualUnit(width, width))
        for level in reversed(range(levels)):
            for last in (False, True):
                attention = [JointAttention(width)] if level == lowest else []
                doubling = [Doubling(width)] if last and level else []
                self.output_blocks.append(nn.Sequential(ResidualUnit(2 * width, width), *attention, *doubling))
        self.out = nn.Sequential(nn.Conv2d(width, width, 3, padding=1), nn.GroupNorm(GROUPS, width), nn.SiLU())

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w) of all views, h and w multiples of 2**(levels - 1)."""
        shortcuts = []
        for block in self.input_blocks:
            features = block(features)
            shortcuts.append(features)
        features = self.middle_block(features)
        for block in self.output_blocks:
            features = block(torch.cat([features, shortcuts.pop()], dim=1))
        last: Tensor = self.out(features)
        return last


def _silent(width: int) -> nn.GroupNorm:
    """A normalisation that gives nothing at first, so that the network begins with its shortcuts."""
    norm = nn.GroupNorm(GROUPS, width)
    nn.init.zeros_(norm.weight)
    return norm
