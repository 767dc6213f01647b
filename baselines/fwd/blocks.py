"""Residual blocks after BigGAN (Brock et al. 2019), without conditioning."""

from typing import Literal

from torch import Tensor, nn
from torch.nn import functional

Resampling = Literal["same", "down", "up"]


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions, each after normalisation and ReLU, beside a 1x1 shortcut.

    Args:
        width_in: channels of the input.
        width: channels of the output.
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
