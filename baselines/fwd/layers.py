"""The parts of FWD: residual blocks after BigGAN, completion of depth, fusion of views by attention."""

from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import spectral_norm

Resampling = Literal["same", "down", "up"]
HALVINGS, WIDTH, WIDEST = 8, 32, 256  # of the completion: stride-2 levels, channels of the first, most channels of any
COMPLETED_MULTIPLE = 2**HALVINGS
SMALLEST_SHARE = 1e-4  # of the largest inverse depth; farther points would be at infinity
HEADS, KEY_WIDTH, VALUE_WIDTH = 4, 16, 64  # widths are those of one head
PIXELS_AT_ONCE = 16384  # that the fusion looks at
UNSEEN = -1e9  # added to the logit of a view that shows nothing; where none shows anything, all weigh the same


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions, each after normalisation and ReLU, beside a 1x1 shortcut.

    Args:
        resampling: ``up`` doubles the size before the first convolution (nearest neighbour), ``down`` halves it after the second
            (mean of four); the shortcut does the same.
    """

    def __init__(self, width_in: int, width: int, resampling: Resampling = "same") -> None:
        super().__init__()
        self.resampling = resampling
        self.norm1, self.norm2 = nn.BatchNorm2d(width_in), nn.BatchNorm2d(width)
        self.conv1 = nn.Conv2d(width_in, width, 3, padding=1)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)
        self.shortcut = nn.Identity() if width_in == width else nn.Conv2d(width_in, width, 1)

    def forward(self, features: Tensor) -> Tensor:
        """(B, width_in, H, W) to (B, width, H', W')."""
        residual = self.conv1(self._grown(functional.relu(self.norm1(features))))
        residual = self._shrunk(self.conv2(functional.relu(self.norm2(residual))))
        shortcut: Tensor = self._shrunk(self._grown(self.shortcut(features)))
        return shortcut + residual

    def _grown(self, features: Tensor) -> Tensor:
        return functional.interpolate(features, scale_factor=2, mode="nearest") if self.resampling == "up" else features

    def _shrunk(self, features: Tensor) -> Tensor:
        return functional.avg_pool2d(features, 2) if self.resampling == "down" else features


class DepthCompletion(nn.Module):
    """Inverse depth everywhere from an image and the inverse depth that is known.

    Reading:
        Spectral normalisation stands on every convolution but the last. Widths double from 32 to 256 and stay there; each level
        downwards is a 4x4 convolution of stride 2, each level upwards doubles bilinearly and convolves 3x3 beside what was seen
        at that size on the way down. The answer replaces known depth, too.
    """

    def __init__(self) -> None:
        super().__init__()
        widths = [4, *(min(WIDTH * 2**level, WIDEST) for level in range(HALVINGS))]
        self.down = nn.ModuleList(
            spectral_norm(nn.Conv2d(before, after, 4, stride=2, padding=1)) for before, after in pairwise(widths)
        )
        self.up = nn.ModuleList(
            spectral_norm(nn.Conv2d(coarse + fine, fine if level else WIDTH, 3, padding=1))
            for level, (fine, coarse) in enumerate(pairwise(widths))
        )
        self.last = nn.Conv2d(WIDTH, 1, 3, padding=1)

    def forward(self, images: Tensor, inverse_depth: Tensor) -> Tensor:
        """Complete some views.

        Args:
            images: (B, 3, H, W) in [-1, 1].
            inverse_depth: as a share of the largest one, (B, 1, H, W), in [0, 1], 0 = unknown.

        Returns:
            Inverse depth as such a share, (B, 1, H, W), above 0 and at most 1.
        """
        height, width = images.shape[2:]
        margins = (0, -width % COMPLETED_MULTIPLE, 0, -height % COMPLETED_MULTIPLE)
        skips = [functional.pad(torch.cat([images, inverse_depth], dim=1), margins)]
        for convolution in self.down:
            skips.append(functional.leaky_relu(convolution(skips[-1]), 0.2))
        features = skips.pop()
        for convolution, before in zip(reversed(self.up), reversed(skips), strict=True):
            grown = functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
            features = functional.relu(convolution(torch.cat([grown, before], dim=1)))
        share = torch.sigmoid(self.last(features))[:, :, :height, :width]
        return share.clamp(min=SMALLEST_SHARE)


class ViewFusion(nn.Module):
    """Multi-head attention over views, pixel by pixel; any number of views, in any order.

    Reading:
        The token is added to what the heads give, then a layer normalisation follows. A view without a point at a pixel is left
        out there.
    """

    def __init__(self, width: int, value_width: int = VALUE_WIDTH) -> None:
        super().__init__()
        self.value_width = value_width
        self.token = nn.Parameter(torch.randn(width) * width**-0.5)
        self.query = nn.Linear(width, HEADS * KEY_WIDTH, bias=False)
        self.key = nn.Linear(width, HEADS * KEY_WIDTH, bias=False)
        self.value = nn.Linear(width, HEADS * value_width, bias=False)
        self.out = nn.Linear(HEADS * value_width, width, bias=False)
        self.norm = nn.LayerNorm(width)

    def forward(self, features: Tensor, alphas: Tensor) -> Tensor:
        """Fuse views.

        Args:
            features: of each view, (K, C, H, W).
            alphas: coverage by each view, (K, H, W).

        Returns:
            (C, H, W).
        """
        views, width, *size = features.shape
        pixels = features.view(views, width, -1).permute(2, 0, 1)  # (P, K, C)
        unseen = (alphas.view(views, -1).T <= 0).float() * UNSEEN  # (P, K)
        chunks = zip(pixels.split(PIXELS_AT_ONCE), unseen.split(PIXELS_AT_ONCE), strict=True)
        return torch.cat([self._fuse(*chunk) for chunk in chunks]).T.reshape(width, *size)

    def _fuse(self, pixels: Tensor, unseen: Tensor) -> Tensor:
        """(P, K, C) and what is added to the logits, (P, K), to (P, C)."""
        count, views, _ = pixels.shape
        query = self.query(self.token).view(HEADS, KEY_WIDTH) * KEY_WIDTH**-0.5
        keys = self.key(pixels).view(count, views, HEADS, KEY_WIDTH)
        logits = (keys * query).sum(dim=-1) + unseen[..., None]  # (P, K, HEADS)
        shares = torch.softmax(logits, dim=1)
        values = self.value(pixels).view(count, views, HEADS, self.value_width)
        mixed = (shares[..., None] * values).sum(dim=1)  # (P, HEADS, self.value_width)
        fused: Tensor = self.norm(self.out(mixed.flatten(1)) + self.token)
        return fused
