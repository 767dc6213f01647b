"""Fills and mends the depth of a source view by a U-Net that sees its image beside it."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import spectral_norm

SIMD_LEVELS, WIDTH, WIDEST = 8, 32, 256  # stride-2 levels, channels of the first, most channels of any
SIZE_MULTIPLE = 2**SIMD_LEVELS
SMALLEST_SHARE = 1e-4  # of the largest inverse depth; farther points would be at infinity


class DepthCompletion(nn.Module):
    """Inverse depth everywhere from an image and the inverse depth that is known.

    Reading:
        Spectral normalisation stands on every convolution but the last. Widths double from 32 to 256 and stay there; each level
        downwards is a 4x4 convolution of stride 2, each level upwards doubles bilinearly and convolves 3x3 beside what was seen
        at that size on the way down. The answer replaces known depth, too.
    """

    def __init__(self) -> None:
        super().__init__()
        widths = [4, *(min(WIDTH * 2**level, WIDEST) for level in range(SIMD_LEVELS))]
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
        margins = (0, -width % SIZE_MULTIPLE, 0, -height % SIZE_MULTIPLE)
        seen = [functional.pad(torch.cat([images, inverse_depth], dim=1), margins)]
        for convolution in self.down:
            seen.append(functional.leaky_relu(convolution(seen[-1]), 0.2))
        features = seen.pop()
        for convolution, before in zip(reversed(self.up), reversed(seen), strict=True):
            grown = functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
            features = functional.relu(convolution(torch.cat([grown, before], dim=1)))
        share = torch.sigmoid(self.last(features))[:, :, :height, :width]
        return share.clamp(min=SMALLEST_SHARE)
