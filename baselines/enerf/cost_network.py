"""From how much the views disagree at each point of a volume to features and to where the surface lies.

Names of modules are those of the published checkpoint.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

SMALLEST_VARIANCE = 1e-10


class CostNetwork(nn.Module):
    """A 3D U-Net.

    Args:
        width_in: channels of the volume.
        deep: a third strided stage, for the fine level.
    """

    def __init__(self, width_in: int, deep: bool) -> None:
        super().__init__()
        self.deep = deep
        self.conv0 = Convolution3d(width_in, 8)
        self.conv1 = Convolution3d(8, 16, stride=2)
        self.conv2 = Convolution3d(16, 16)
        self.conv3 = Convolution3d(16, 32, stride=2)
        self.conv4 = Convolution3d(32, 32)
        if deep:
            self.conv5 = Convolution3d(32, 64, stride=2)
            self.conv6 = Convolution3d(64, 64)
            self.conv7 = _enlarging(64, 32)
        self.conv9 = _enlarging(32, 16)
        self.conv11 = _enlarging(16, 8)
        self.depth_conv = nn.Sequential(nn.Conv3d(8, 1, 3, padding=1, bias=False))
        self.feat_conv = nn.Sequential(nn.Conv3d(8, 8, 3, padding=1, bias=False))

    def forward(self, volume: Tensor) -> tuple[Tensor, Tensor]:
        """Features and score of each cell.

        Args:
            volume: (B, C, D, H, W), sides multiples of 4, or of 8 if deep.

        Returns:
            (B, 8, D, H, W) and (B, D, H, W), the score before its softmax over D.
        """
        full = self.conv0(volume)
        half = self.conv2(self.conv1(full))
        quarter = self.conv4(self.conv3(half))
        if self.deep:
            quarter = quarter + self.conv7(self.conv6(self.conv5(quarter)))
        half = half + self.conv9(quarter)
        full = full + self.conv11(half)
        return self.feat_conv(full), self.depth_conv(full)[:, 0]


class Convolution3d(nn.Module):
    """3x3x3 convolution, normalisation, ReLU."""

    def __init__(self, width_in: int, width: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv3d(width_in, width, 3, stride, padding=1, bias=False)
        self.bn = nn.BatchNorm3d(width)

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, D, H, W) to (B, width, D / stride, H / stride, W / stride)."""
        return functional.relu(self.bn(self.conv(features)))


def expectation(scores: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation of values under the softmax of their scores.

    Args:
        scores: (D, H, W).
        values: broadcastable to it.

    Returns:
        (H, W) twice; the deviation is at least 1e-5.
    """
    shares = torch.softmax(scores, dim=0)
    mean = (shares * values).sum(dim=0)
    variance = (shares * (values - mean) ** 2).sum(dim=0)
    return mean, variance.clamp(min=SMALLEST_VARIANCE).sqrt()


def _enlarging(width_in: int, width: int) -> nn.Sequential:
    """Transposed convolution to twice the size, normalised."""
    enlarged = nn.ConvTranspose3d(width_in, width, 3, stride=2, padding=1, output_padding=1, bias=False)
    return nn.Sequential(enlarged, nn.BatchNorm3d(width))
