"""IBRNet's networks: the residual U-Net that sees the source images, beside the two of its rays; and their weights.

Names of modules are those of the published checkpoint. Instance normalisation makes images independent of each other.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.baselines.ibrnet.ray_network import RayNetwork
from ggvs_eval.baselines.learned import FULL
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors

WIDTH_EACH = 32  # feature channels of each of the two passes
SMALLEST_SIDE_PX = 33  # reflection at 1/16 of the size wants at least two cells
PARTS = ("net_coarse", "net_fine", "feature_net")  # as the checkpoint calls them


class FeatureNetwork(nn.Module):
    """Three residual stages (3, 4 and 6 blocks) down to 1/16, two skip connections back to 1/4 of the image's size.

    Args:
        width: channels of the first stage; the next ones have twice and four times as many.
    """

    def __init__(self, width: int = 64, blocks: tuple[int, int, int] = (3, 4, 6)) -> None:
        super().__init__()
        self.conv1 = _convolution(3, width, 7, stride=2, bias=False)
        self.bn1 = nn.InstanceNorm2d(width, affine=True)
        self.layer1 = _stage(width, width, blocks[0])
        self.layer2 = _stage(width, 2 * width, blocks[1])
        self.layer3 = _stage(2 * width, 4 * width, blocks[2])
        self.upconv3 = _Upsampled(4 * width, 2 * width)
        self.iconv3 = _Normalised(4 * width, 2 * width)
        self.upconv2 = _Upsampled(2 * width, width)
        self.iconv2 = _Normalised(2 * width, width)
        self.out_conv = nn.Conv2d(width, 2 * WIDTH_EACH, 1)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Features for the coarse and the fine pass.

        Args:
            images: (B, 3, H, W), RGB in [0, 1], sides of at least 33 pixels.

        Returns:
            (B, 32, h, w) twice, h = 4 * ceil(H / 16), w = 4 * ceil(W / 16): at 1/4 of the image's size.
        """
        quarter = self.layer1(torch.relu(self.bn1(self.conv1(images))))
        eighth = self.layer2(quarter)
        features = self.iconv3(_beside(eighth, self.upconv3(self.layer3(eighth))))
        features = self.iconv2(_beside(quarter, self.upconv2(features)))
        coarse, fine = self.out_conv(features).split(WIDTH_EACH, dim=1)
        return coarse, fine


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions beside a shortcut."""

    def __init__(self, width_in: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = _convolution(width_in, width, 3, stride, bias=False)
        self.bn1 = nn.InstanceNorm2d(width, affine=True)
        self.conv2 = _convolution(width, width, 3, bias=False)
        self.bn2 = nn.InstanceNorm2d(width, affine=True)
        self.downsample: nn.Module | None = None
        if stride > 1 or width_in != width:
            shortcut = nn.Conv2d(width_in, width, 1, stride, bias=False)
            self.downsample = nn.Sequential(shortcut, nn.InstanceNorm2d(width, affine=True))

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, H / stride, W / stride)."""
        residual = self.bn2(self.conv2(torch.relu(self.bn1(self.conv1(features)))))
        shortcut = features if self.downsample is None else self.downsample(features)
        return torch.relu(shortcut + residual)


class _Normalised(nn.Module):
    """3x3 convolution, normalisation, ELU."""

    def __init__(self, width_in: int, width: int) -> None:
        super().__init__()
        self.conv = _convolution(width_in, width, 3)
        self.bn = nn.InstanceNorm2d(width, affine=True)

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, H, W)."""
        return functional.elu(self.bn(self.conv(features)))


class _Upsampled(nn.Module):
    """The same at twice the size."""

    def __init__(self, width_in: int, width: int) -> None:
        super().__init__()
        self.conv = _Normalised(width_in, width)

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, 2 H, 2 W)."""
        larger = functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=True)
        convolved: Tensor = self.conv(larger)
        return convolved


def _beside(skipped: Tensor, upsampled: Tensor) -> Tensor:
    """Both in one tensor of the upsampled one's size; zeros around the skipped one where a side was odd on the way down."""
    missing = [upsampled.shape[axis] - skipped.shape[axis] for axis in (3, 2)]
    borders = [border for gap in missing for border in (gap // 2, gap - gap // 2)]
    return torch.cat([upsampled, functional.pad(skipped, borders)], dim=1)


def _stage(width_in: int, width: int, blocks: int) -> nn.Sequential:
    first = ResidualBlock(width_in, width, stride=2)
    return nn.Sequential(first, *(ResidualBlock(width, width, stride=1) for _ in range(blocks - 1)))


def _convolution(width_in: int, width: int, size: int, stride: int = 1, bias: bool = True) -> nn.Conv2d:
    return nn.Conv2d(width_in, width, size, stride, padding=size // 2, padding_mode="reflect", bias=bias)


@dataclass(frozen=True)
class IbrnetOptions:
    """Shape of the networks, and how finely a ray is sampled.

    Attributes:
        width: channels of the feature network's first stage.
        blocks: residual blocks of its stages.
        samples: of the coarse pass of a ray; the fine pass adds as many.
    """

    width: int = 64
    blocks: tuple[int, int, int] = (3, 4, 6)
    samples: int = 64


CONFIGURATIONS = {"full": IbrnetOptions(), "compact": IbrnetOptions(16, (2, 2, 2), 32)}


class Networks(nn.Module):
    """All that is trained, under the names of the published checkpoint's three state dicts."""

    def __init__(self, configuration: str = FULL) -> None:
        super().__init__()
        self.configuration = configuration
        self.config = config = CONFIGURATIONS[configuration]
        self.net_coarse = RayNetwork()
        self.net_fine = RayNetwork()
        self.feature_net = FeatureNetwork(config.width, config.blocks)


def load_ibrnet(path: Path) -> Networks:
    """The networks of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint, a dict with ``net_coarse``, ``net_fine`` and ``feature_net``, or safetensors whose names
            begin so.
    """
    networks = Networks(configuration_of(path, CONFIGURATIONS, "IBRNet") or FULL)
    for part in PARTS:
        of = f"IBRNet's {part}"
        load_strict(read_tensors(path, part, of=of), networks.get_submodule(part), path, of)
    return networks.eval().requires_grad_(False)
