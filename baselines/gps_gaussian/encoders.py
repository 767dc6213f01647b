"""Features of images and of depth maps at a half, a quarter and an eighth of their size.

Names of modules are those of the published checkpoint.
"""

from torch import Tensor, nn

CHANNELS_PER_GROUP = 8  # of the residual blocks' group normalisation
STEM_WIDTH, STEM_GROUPS = 32, 8

Pyramid = tuple[Tensor, Tensor, Tensor]  # features at 1/2, 1/4 and 1/8 of the size


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions beside a shortcut, ReLU after each normalisation and after the sum."""

    def __init__(self, width_in: int, width: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width_in, width, 3, stride, padding=1)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)
        self.norm1, self.norm2 = _normalisation(width), _normalisation(width)
        self.relu = nn.ReLU()
        self.downsample: nn.Module | None = None
        if stride > 1 or width_in != width:
            self.norm3 = _normalisation(width)  # the checkpoint lists it twice, under both names
            self.downsample = nn.Sequential(nn.Conv2d(width_in, width, 1, stride), self.norm3)

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, H / stride, W / stride)."""
        residual = self.relu(self.norm1(self.conv1(features)))
        residual = self.relu(self.norm2(self.conv2(residual)))
        shortcut = features if self.downsample is None else self.downsample(features)
        return self.relu(shortcut + residual)


class PyramidEncoder(nn.Module):
    """A 5x5 convolution that halves, then three stages of two residual blocks; the last two halve again.

    Args:
        channels: of the input: 3 for images, 1 for inverse depth.
        widths: channels of the three stages.
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
    return nn.Sequential(ResidualBlock(width_in, width, stride), ResidualBlock(width, width))


def _normalisation(width: int) -> nn.Module:
    return nn.GroupNorm(width // CHANNELS_PER_GROUP, width)
