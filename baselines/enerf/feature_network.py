"""What ENeRF sees of a source image: a feature pyramid at three sizes.

Names of modules are those of the published checkpoint.
"""

from torch import Tensor, nn
from torch.nn import functional


class FeatureNetwork(nn.Module):
    """Two strided stages down, lateral connections back up."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = nn.Sequential(Convolution2d(3, 8, 3), Convolution2d(8, 8, 3))
        self.conv1 = nn.Sequential(Convolution2d(8, 16, 5, stride=2), Convolution2d(16, 16, 3))
        self.conv2 = nn.Sequential(Convolution2d(16, 32, 5, stride=2), Convolution2d(32, 32, 3))
        self.toplayer = nn.Conv2d(32, 32, 1)
        self.lat1 = nn.Conv2d(16, 32, 1)
        self.lat0 = nn.Conv2d(8, 32, 1)
        self.smooth1 = nn.Conv2d(32, 16, 3, padding=1)
        self.smooth0 = nn.Conv2d(32, 8, 3, padding=1)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features of three levels.

        Args:
            images: (B, 3, H, W), RGB in [-1, 1], H and W multiples of 4.

        Returns:
            (B, 32, H / 4, W / 4), (B, 16, H / 2, W / 2) and (B, 8, H, W).
        """
        full = self.conv0(images)
        half = self.conv1(full)
        quarter: Tensor = self.toplayer(self.conv2(half))
        of_half = _twice(quarter) + self.lat1(half)
        of_full = _twice(of_half) + self.lat0(full)
        return quarter, self.smooth1(of_half), self.smooth0(of_full)


class Convolution2d(nn.Module):
    """Convolution, normalisation, ReLU."""

    def __init__(self, width_in: int, width: int, size: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(width_in, width, size, stride, padding=size // 2, bias=False)
        self.bn = nn.BatchNorm2d(width)

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, H / stride, W / stride)."""
        return functional.relu(self.bn(self.conv(features)))


def _twice(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=True)
