"""The Gaussian half: rotation, scale and opacity of one Gaussian per pixel.

Names of modules are those of the published checkpoint.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.baselines.gps_gaussian.encoders import Pyramid, PyramidEncoder, two_blocks

HEAD_WIDTH = 32
MAX_SCALE_M = 0.01  # no Gaussian has a larger standard deviation


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
        encoder_widths: channels of either pyramid.
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
        seen = functional.relu(self.out_conv(torch.cat([decoded, images, inverse_depth], dim=1)))
        return GaussianMaps(
            functional.normalize(self.rot_head(seen), dim=1),
            functional.softplus(self.scale_head(seen), beta=100).clamp(max=MAX_SCALE_M),
            torch.sigmoid(self.opacity_head(seen)),
        )


def _head(channels: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(HEAD_WIDTH, HEAD_WIDTH, 3, padding=1), nn.ReLU(), nn.Conv2d(HEAD_WIDTH, channels, 1))


def _double(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
