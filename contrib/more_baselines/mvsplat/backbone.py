"""Features of every source view: a convolutional network of each image, then attention within and
between the views.

Names of modules are those of the published checkpoint, which are those of UniMatch (Xu et al.
2023).
"""

from collections.abc import Iterator
from math import pi

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.functional import scaled_dot_product_attention as attention

from ggvs_eval.residual_block import ResidualBlock

IMAGE_MEAN, IMAGE_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet
SCALE = 4  # pixels along the side of a cell, which has one feature
EXPANSION = 4  # of the channels within the transformer's perceptrons
LONGEST_WAVE = 10000.0  # of the position's sines, in windows
Block = tuple[slice, slice, int, int]  # rows, columns, and into how many windows they are cut


class ConvolutionalEncoder(nn.Module):
    """Features of one image at a quarter of its size ('backbone')."""

    def __init__(self, widths: tuple[int, int, int], width: int) -> None:
        super().__init__()
        half, quarter, last = widths
        self.conv1 = nn.Conv2d(3, half, 7, stride=2, padding=3, bias=False)
        self.norm1 = nn.InstanceNorm2d(half)
        self.layer1 = _stage(half, half)
        self.layer2 = _stage(half, quarter, stride=2)
        self.layer3 = _stage(quarter, last)
        self.conv2 = nn.Conv2d(last, width, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Return the RGB in [0, 1], (K, 3, H, W), to (K, width, H / 4, W / 4)."""
        mean, deviation = (
            images.new_tensor(values)[:, None, None] for values in (IMAGE_MEAN, IMAGE_DEVIATION)
        )
        stem = functional.relu(self.norm1(self.conv1((images - mean) / deviation)))
        features: Tensor = self.conv2(self.layer3(self.layer2(self.layer1(stem))))
        return features


def _stage(width_in: int, width: int, stride: int = 1) -> nn.Sequential:
    """Return two residual blocks, the first of which changes width and size."""
    blocks = [(width_in, stride), (width, 1)]
    return nn.Sequential(
        *(
            ResidualBlock(
                width_in=entry, width=width, normalise=nn.InstanceNorm2d, stride=step, bias=False
            )
            for entry, step in blocks
        )
    )


class AttentionLayer(nn.Module):
    """Attention of one head within windows, added to what asks.

    After it a perceptron if there is one.
    """

    def __init__(self, width: int, perceptron: bool) -> None:
        super().__init__()
        self.q_proj, self.k_proj, self.v_proj, self.merge = (
            nn.Linear(width, width, bias=False) for _ in range(4)
        )
        self.norm1 = nn.LayerNorm(width)
        self.mlp: nn.Module | None = None
        if perceptron:
            inner = 2 * width * EXPANSION
            self.mlp = nn.Sequential(
                nn.Linear(2 * width, inner, bias=False),
                nn.GELU(),
                nn.Linear(inner, width, bias=False),
            )
            self.norm2 = nn.LayerNorm(width)

    @property
    def last_norm(self) -> nn.LayerNorm:
        """The normalisation of what is added."""
        return self.norm1 if self.mlp is None else self.norm2

    def forward(self, views: Tensor, context: Tensor | None, blocks: list[Block]) -> Tensor:
        """Update the features of every view.

        Args:
            views: (K, h, w, C).
            context: what each view sees of the others, features of all K; None if each looks at
                itself.
        """
        target = views if context is None else context
        attended = _attend(
            self.q_proj(views),
            self.k_proj(target),
            self.v_proj(target),
            blocks,
            across=context is not None,
        )
        message = self.norm1(self.merge(attended))
        if self.mlp is not None:
            message = self.norm2(self.mlp(torch.cat([views, message], dim=-1)))
        return views + message


def _attend(query: Tensor, key: Tensor, value: Tensor, blocks: list[Block], across: bool) -> Tensor:
    """Return the sum of the values of a window's cells, those of the own view or those of all
    others, all (K, h, w, C).
    """
    attended = torch.empty_like(query)
    for rows, columns, down, right in blocks:
        # (K, n, L, C)
        queries, keys, values = (
            _windows(maps[:, rows, columns], down, right) for maps in (query, key, value)
        )
        if across:
            answers = torch.cat(
                [
                    attention(queries[view, None], _others(keys, view), _others(values, view))
                    for view in range(len(query))
                ]
            )
        else:
            answers = attention(queries, keys, values)
        attended[:, rows, columns] = _whole(answers, down, right, attended[:, rows, columns].shape)
    return attended


def _others(windows: Tensor, view: int) -> Tensor:
    """Return the windows of all views but one, side by side as one each, (K, n, L, C) to (1, n, (K
    - 1) * L, C).
    """
    windows_left = torch.cat([windows[:view], windows[view + 1 :]])
    return windows_left.transpose(0, 1).flatten(1, 2)[None]


def _windows(maps: Tensor, down: int, right: int) -> Tensor:
    """(K, h, w, C) to (K, down * right, cells of a window, C)."""
    count, height, width, channels = maps.shape
    cut = maps.reshape(count, down, height // down, right, width // right, channels)
    return cut.transpose(2, 3).reshape(count, down * right, -1, channels)


def _whole(windows: Tensor, down: int, right: int, shape: torch.Size) -> Tensor:
    """Return the inverse of `_windows`."""
    count, height, width, channels = shape
    cut = windows.reshape(count, down, right, height // down, width // right, channels)
    return cut.transpose(2, 3).reshape(shape)


class TransformerBlock(nn.Module):
    """A view looks at itself, then at the others."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.self_attn = AttentionLayer(width, perceptron=False)
        self.cross_attn_ffn = AttentionLayer(width, perceptron=True)

    def forward(self, views: Tensor, blocks: list[Block]) -> Tensor:
        """Return the features of all views (K, h, w, C); the others are seen as they came in."""
        features: Tensor = self.cross_attn_ffn(self.self_attn(views, None, blocks), views, blocks)
        return features


class Transformer(nn.Module):
    """Layers whose windows are alternately on the grid and half a window off it."""

    def __init__(self, layers: int, width: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(TransformerBlock(width) for _ in range(layers))

    def forward(self, views: Tensor, window: tuple[int, int]) -> Tensor:
        """Return the features that know of the other views, (K, h, w, C).

        Args:
            views: at least two, (K, h, w, C).
            window: height and width of a window; h and w are multiples of them.
        """
        for number, layer in enumerate(self.layers):
            _, height, width, _ = views.shape
            views = layer(views, window_blocks(height, width, window, shifted=number % 2 == 1))
        return views


def window_blocks(height: int, width: int, window: tuple[int, int], shifted: bool) -> list[Block]:
    """Cut a map into windows, grouped by their size.

    Args:
        shifted: whether the grid is moved by half a window; what is left at the borders are smaller
            windows.

    Reading:
        The authors roll the map, so that opposite borders meet in one window, and forbid what does
        not belong together by -100 before the softmax. That is what smaller windows at the borders
        give, to within exp(-100).
    """
    down, right = (
        list(_cuts(side, length, length // 2 if shifted else 0))
        for side, length in zip((height, width), window, strict=True)
    )
    return [(rows, columns, many, more) for rows, many in down for columns, more in right]


def _cuts(side: int, length: int, shift: int) -> Iterator[tuple[slice, int]]:
    """Yield the stretches of a side, each with the number of equal windows in it."""
    if shift:
        yield slice(0, shift), 1
    n_windows = (side - shift) // length
    if n_windows:
        yield slice(shift, shift + n_windows * length), n_windows
    if shift + n_windows * length < side:
        yield slice(shift + n_windows * length, side), 1


def window_position(height: int, width: int, channels: int) -> Tensor:
    """Sines of the place within a window (Carion et al. 2020), (height, width, channels): those of
    the row first.
    """
    parts = []
    for side in (height, width):
        place = torch.arange(1, side + 1, dtype=torch.float32) / (side + 1e-6) * 2 * pi
        number = torch.arange(channels // 2)
        waves = LONGEST_WAVE ** (2 * (number // 2) / (channels // 2))
        angle = place[:, None] / waves
        parts.append(torch.where(number % 2 == 0, angle.sin(), angle.cos()))
    down, across = parts
    return torch.cat(
        [down[:, None].expand(-1, width, -1), across[None].expand(height, -1, -1)], dim=-1
    )


class Backbone(nn.Module):
    """Features of every view ('backbone'), and those that know of the other views
    ('transformer').
    """

    def __init__(self, stages: tuple[int, int, int], width: int, layers: int) -> None:
        super().__init__()
        self.backbone = ConvolutionalEncoder(stages, width)
        self.transformer = Transformer(layers, width)

    def forward(self, images: Tensor, window: int | None) -> tuple[Tensor, Tensor]:
        """Return the features of all views at a quarter of their size.

        Args:
            images: RGB in [0, 1], (K, 3, H, W), K at least 2.
            window: cells along the side of a window; None for windows of half the map.

        Returns:
            Features that know of the other views, and those of each image alone, both (K, width, H
            / 4, W / 4).
        """
        alone: Tensor = self.backbone(images)
        height, width = alone.shape[2:]
        size = (height // 2, width // 2) if window is None else (window, window)
        position = window_position(*size, alone.shape[1]).to(alone.dtype)
        placed = alone.permute(0, 2, 3, 1) + position.repeat(height // size[0], width // size[1], 1)
        together: Tensor = self.transformer(placed.contiguous(), size)
        return together.permute(0, 3, 1, 2).contiguous(), alone
