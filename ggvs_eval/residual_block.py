"""The residual block of RAFT and of the networks that descend from it."""

from collections.abc import Callable

from torch import Tensor, nn


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with a shortcut, ReLU after each normalisation and after the sum.

    Names of modules are those of the published checkpoints of RAFT-Stereo, GPS-Gaussian and
    MVSplat.
    """

    def __init__(
        self,
        width_in: int,
        width: int,
        normalise: Callable[[int], nn.Module],
        stride: int = 1,
        bias: bool = True,
    ) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width_in, width, 3, stride, padding=1, bias=bias)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1, bias=bias)
        self.norm1, self.norm2 = normalise(width), normalise(width)
        self.relu = nn.ReLU()
        self.downsample: nn.Module | None = None
        if stride > 1 or width_in != width:
            self.norm3 = normalise(width)  # the checkpoints list it twice, under both names
            self.downsample = nn.Sequential(nn.Conv2d(width_in, width, 1, stride), self.norm3)

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, H / stride, W / stride)."""
        residual = self.relu(self.norm1(self.conv1(features)))
        residual = self.relu(self.norm2(self.conv2(residual)))
        shortcut = features if self.downsample is None else self.downsample(features)
        return self.relu(shortcut + residual)
