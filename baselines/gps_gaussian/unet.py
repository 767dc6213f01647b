"""Features of images and of depth maps, and what is decoded from both: rotation, scale and opacity of a Gaussian per pixel.

Names of modules are those of the published checkpoint.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.residual_block import ResidualBlock

CHANNELS_PER_GROUP = 8  # of the residual blocks' group normalisation
STEM_WIDTH, STEM_GROUPS = 32, 8
HEAD_WIDTH = 32
MAX_SCALE_M = 0.01  # no Gaussian has a larger standard deviation

Pyramid = tuple[Tensor, Tensor, Tensor]  # features at 1/2, 1/4 and 1/8 of the size


class PyramidEncoder(nn.Module):
    """A 5x5 convolution that halves, then three stages of two residual blocks; the last two halve again.

    Args:
        channels: of the input: 3 for images, 1 for inverse depth.
    """

    def __init__(self, channels: int, widths: tuple[int, int, int]) -> None:
        super().__init__()
        narrow, middle, wide = widths
        self.in_ds = nn.Sequential(
            nn.Conv2d(channels, STEM_WIDTH, 5, stride=2, padding=2), nn.GroupNorm(STEM_GROUPS, STEM_WIDTH), nn.ReLU()
        )
        self.res1 = two_blocks(STEM_WIDTH, narrow)
        self.res2 = two_blocks(narrow, middle, stride=2)
        self.res3 = two_blocks(middle, wide, stride=2)

    def forward(self, maps: Tensor) -> Pyramid:
        """(B, C, H, W), H and W multiples of 8, to features at 1/2, 1/4 and 1/8 of that size."""
        half = self.res1(self.in_ds(maps))
        quarter = self.res2(half)
        return half, quarter, self.res3(quarter)


def two_blocks(width_in: int, width: int, stride: int = 1) -> nn.Sequential:
    """Two residual blocks, the first of which changes width and size."""
    return nn.Sequential(residual_block(width_in, width, stride), residual_block(width, width))


def residual_block(width_in: int, width: int, stride: int = 1) -> ResidualBlock:
    """A residual block with group normalisation."""
    return ResidualBlock(width_in, width, _normalisation, stride)


def _normalisation(width: int) -> nn.Module:
    return nn.GroupNorm(width // CHANNELS_PER_GROUP, width)


class GaussianMaps(NamedTuple):
    """Shape of the Gaussian of each pixel.

    Attributes:
        rotation: unit quaternions w, x, y, z, (B, 4, H, W).
        scale_m: standard deviations along the three axes, metres, (B, 3, H, W).
        opacity: (B, 1, H, W), in [0, 1].
    """

    rotation: Tensor
    scale_m: Tensor
    opacity: Tensor


class GaussianRegressor(nn.Module):
    """A U-Net over features of image and depth ('gs_parm_regresser').

    Args:
        decoder_widths: channels of the decoder at 1/2, 1/4 and 1/8 of the size.
    """

    def __init__(
        self, encoder_widths: tuple[int, int, int] = (32, 48, 96), decoder_widths: tuple[int, int, int] = (48, 64, 96)
    ) -> None:
        super().__init__()
        half, quarter, eighth = encoder_widths
        fine, middle, coarse = decoder_widths
        self.depth_encoder = PyramidEncoder(1, encoder_widths)
        self.decoder3 = two_blocks(2 * eighth, coarse)
        self.decoder2 = two_blocks(2 * quarter + coarse, middle)
        self.decoder1 = two_blocks(2 * half + middle, fine)
        self.out_conv = nn.Conv2d(fine + 3 + 1, HEAD_WIDTH, 3, padding=1)
        self.rot_head = _head(4)
        self.scale_head = _head(3)
        self.opacity_head = _head(1)

    def forward(self, images: Tensor, inverse_depth: Tensor, image_features: Pyramid) -> GaussianMaps:
        """Gaussians of some views.

        Args:
            images: (B, 3, H, W) in [-1, 1], H and W multiples of 8.
            inverse_depth: per metre, (B, 1, H, W), 0 = unknown.
            image_features: features of the images at 1/2, 1/4 and 1/8 of their size.
        """
        half, quarter, eighth = (
            torch.cat(pair, dim=1) for pair in zip(image_features, self.depth_encoder(inverse_depth), strict=True)
        )
        decoded = _double(self.decoder3(eighth))
        decoded = _double(self.decoder2(torch.cat([decoded, quarter], dim=1)))
        decoded = _double(self.decoder1(torch.cat([decoded, half], dim=1)))
        features = functional.relu(self.out_conv(torch.cat([decoded, images, inverse_depth], dim=1)))
        return GaussianMaps(
            functional.normalize(self.rot_head(features), dim=1),
            functional.softplus(self.scale_head(features), beta=100).clamp(max=MAX_SCALE_M),
            torch.sigmoid(self.opacity_head(features)),
        )


def _head(channels: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(HEAD_WIDTH, HEAD_WIDTH, 3, padding=1), nn.ReLU(), nn.Conv2d(HEAD_WIDTH, channels, 1))


def _double(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
