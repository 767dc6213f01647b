"""MVSNeRF's networks: features of an image, a 3D U-Net over the volume, radiance of samples.

And where their weights come from.

Names of modules are those of the published checkpoint.
"""

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.files.weights_file import load_strict, read_tensors

VIEWS = 3  # of the volume; the widths of the networks depend on it
VOXEL_WIDTH, FEATURE_WIDTH, HIDDEN_WIDTH = 8, 32, 128
LAYERS, SKIPPING_LAYER = 6, 4
OCTAVES = 10  # of the encoding of places
SLOPE = 0.01  # of what is negative


class Normalisation(nn.BatchNorm2d):
    """Batch normalisation and leaky ReLU, of images or volumes.

    The scale is the weight's magnitude.

    Reading:
        Statistics are of what is at hand, the running ones of the checkpoint are not used: the
        authors' evaluation leaves their network in training mode.
    """

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, ...) to the same."""
        scale = self.weight.abs() + self.eps
        normalised = functional.batch_norm(
            features, None, None, scale, self.bias, training=True, eps=self.eps
        )
        return functional.leaky_relu(normalised, SLOPE)


class Convolution2d(nn.Module):
    """Convolution of an image, normalised."""

    def __init__(self, width_in: int, width: int, size: int = 3, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(width_in, width, size, stride, padding=size // 2, bias=False)
        self.bn = Normalisation(width)

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, H / stride, W / stride)."""
        normalised: Tensor = self.bn(self.conv(features))
        return normalised


class Convolution3d(nn.Module):
    """3x3x3 convolution of a volume, normalised."""

    def __init__(self, width_in: int, width: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv3d(width_in, width, 3, stride, padding=1, bias=False)
        self.bn = Normalisation(width)

    def forward(self, volume: Tensor) -> Tensor:
        """(B, C, D, H, W) to (B, width, D / stride, H / stride, W / stride)."""
        normalised: Tensor = self.bn(self.conv(volume))
        return normalised


def _enlarging(width_in: int, width: int) -> nn.Sequential:
    """Return the transposed convolution to twice the size, normalised."""
    enlarged = nn.ConvTranspose3d(
        width_in, width, 3, stride=2, padding=1, output_padding=1, bias=False
    )
    return nn.Sequential(enlarged, Normalisation(width))


class FeatureNetwork(nn.Module):
    """Two strided stages down."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = nn.Sequential(Convolution2d(3, 8), Convolution2d(8, 8))
        self.conv1 = nn.Sequential(
            Convolution2d(8, 16, 5, stride=2), Convolution2d(16, 16), Convolution2d(16, 16)
        )
        self.conv2 = nn.Sequential(
            Convolution2d(16, 32, 5, stride=2), Convolution2d(32, 32), Convolution2d(32, 32)
        )
        self.toplayer = nn.Conv2d(32, FEATURE_WIDTH, 1)

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W), normalised as ImageNet's, sides multiples of 4, to (B, 32, H / 4, W
        / 4).
        """
        features: Tensor = self.toplayer(self.conv2(self.conv1(self.conv0(images))))
        return features


class CostNetwork(nn.Module):
    """A 3D U-Net of three strided stages."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = Convolution3d(FEATURE_WIDTH + 3 * VIEWS, VOXEL_WIDTH)
        self.conv1 = Convolution3d(8, 16, stride=2)
        self.conv2 = Convolution3d(16, 16)
        self.conv3 = Convolution3d(16, 32, stride=2)
        self.conv4 = Convolution3d(32, 32)
        self.conv5 = Convolution3d(32, 64, stride=2)
        self.conv6 = Convolution3d(64, 64)
        self.conv7 = _enlarging(64, 32)
        self.conv9 = _enlarging(32, 16)
        self.conv11 = _enlarging(16, 8)

    def forward(self, volume: Tensor) -> Tensor:
        """(B, 41, D, H, W), sides multiples of 8, to (B, 8, D, H, W)."""
        full = self.conv0(volume)
        half = self.conv2(self.conv1(full))
        quarter = self.conv4(self.conv3(half))
        quarter = quarter + self.conv7(self.conv6(self.conv5(quarter)))
        half = half + self.conv9(quarter)
        features: Tensor = full + self.conv11(half)
        return features


class Encoding(nn.Module):
    """All that makes the volume; the authors' ``MVSNet``."""

    def __init__(self) -> None:
        super().__init__()
        self.feature = FeatureNetwork()
        self.cost_reg_2 = CostNetwork()


class RadianceNetwork(nn.Module):
    """Colour and density of samples.

    What the volume and the views show there scales every layer.
    """

    def __init__(self) -> None:
        super().__init__()
        place_width = 3 * (1 + 2 * OCTAVES)
        widths = [place_width] + [
            HIDDEN_WIDTH + (place_width if i == SKIPPING_LAYER + 1 else 0) for i in range(1, LAYERS)
        ]
        self.pts_linears = nn.ModuleList([nn.Linear(width, HIDDEN_WIDTH) for width in widths])
        self.pts_bias = nn.Linear(VOXEL_WIDTH + 4 * VIEWS, HIDDEN_WIDTH)
        self.views_linears = nn.ModuleList([nn.Linear(HIDDEN_WIDTH + 3, HIDDEN_WIDTH // 2)])
        self.feature_linear = nn.Linear(HIDDEN_WIDTH, HIDDEN_WIDTH)
        self.alpha_linear = nn.Linear(HIDDEN_WIDTH, 1)
        self.rgb_linear = nn.Linear(HIDDEN_WIDTH // 2, 3)

    def forward(
        self, places: Tensor, features: Tensor, directions: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the colour and density of each sample.

        Args:
            places: in the volume, its sides from 0 to 1, (N, 3).
            features: features of the volume there, and of each view colour and whether it sees the
                sample, (N, 8 + 12).
            directions: of the target's ray in the frame of the reference, unit, (N, 3).

        Returns:
            RGB, (N, 3), and density per sample, not per length, (N,).
        """
        encoded = encode(places)
        scale, hidden = self.pts_bias(features), encoded
        for i, layer in enumerate(self.pts_linears):
            hidden = layer(hidden).mul_(scale).relu_()  # in place, as memory is what takes the time
            if i == SKIPPING_LAYER:
                hidden = torch.cat([encoded, hidden], dim=-1)
        density = functional.relu(self.alpha_linear(hidden))[:, 0]
        coloured = torch.cat([self.feature_linear(hidden), directions], dim=-1)
        return torch.sigmoid(
            self.rgb_linear(functional.relu(self.views_linears[0](coloured)))
        ), density


def encode(places: Tensor) -> Tensor:
    """Return the places, then their sines and cosines of ten octaves, (N, 3) to (N, 63)."""
    waves = (places[:, None] * 2.0 ** torch.arange(OCTAVES)[:, None]).flatten(1)
    return torch.cat([places, waves.sin(), waves.cos()], dim=-1)


class Radiance(nn.Module):
    """The authors' ``MVSNeRF``, which holds its network one name deeper."""

    def __init__(self) -> None:
        super().__init__()
        self.nerf = RadianceNetwork()


class Networks(nn.Module):
    """Both networks, under the names by which the checkpoint has them."""

    def __init__(self) -> None:
        super().__init__()
        self.network_mvs = Encoding()
        self.network_fn = Radiance()


def load_mvsnerf(path: Path) -> Networks:
    """Return the networks of the authors' checkpoint, a dict with ``network_mvs_state_dict`` and
    ``network_fn_state_dict``.

    Raises:
        WeightsError: absent, damaged, more than tensors and numbers inside, or tensors of another
            network.
    """
    networks = Networks()
    for name, network in networks.named_children():
        load_strict(
            read_tensors(path, f"{name}_state_dict", model="MVSNeRF"), network, path, "MVSNeRF"
        )
    return networks.eval().requires_grad_(False)
