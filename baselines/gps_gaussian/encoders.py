"""Features of images and of depth maps at a half, a quarter and an eighth of their size.

Names of modules are those of the published checkpoint.
"""

from torch import Tensor, nn

from ggvs_eval.residual_block import ResidualBlock

CHANNELS_PER_GROUP = 8  # of the residual blocks' group normalisation
STEM_WIDTH, STEM_GROUPS = 32, 8

Pyramid = tuple[Tensor, Tensor, Tensor]  # features at 1/2, 1/4 and 1/8 of the size


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
    return nn.Sequential(residual_block(width_in, width, stride), residual_block(width, width))


def residual_block(width_in: int, width: int, stride: int = 1) -> ResidualBlock:
    """A residual block with group normalisation."""
    return ResidualBlock(width_in, width, _normalisation, stride)


def _normalisation(width: int) -> nn.Module:
    return nn.GroupNorm(width // CHANNELS_PER_GROUP, width)
