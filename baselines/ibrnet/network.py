"""IBRNet's networks: the residual U-Net that sees the source images, and density and colour of a
ray's samples; their weights.

Names of modules are those of the published checkpoint.

Names of modules are those of the published checkpoint. Instance normalisation makes images
independent of each other.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.baselines.learned import FULL
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors

WIDTH = 16  # of a sample's density feature
HEADS = 4  # of the attention along a ray
SEEN = 35  # colour and features of one view at one sample
EPSILON = 1e-8
WIDTH_EACH = 32  # feature channels of each of the two passes
SMALLEST_SIDE_PX = 33  # reflection at 1/16 of the size wants at least two cells
PARTS = ("net_coarse", "net_fine", "feature_net")  # as the checkpoint calls them


class FeatureNetwork(nn.Module):
    """Three residual stages (3, 4 and 6 blocks) down to 1/16, two skip connections back to 1/4 of
    the image's size.

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
        """Return the features for the coarse and the fine pass.

        Args:
            images: (B, 3, H, W), RGB in [0, 1], sides of at least 33 pixels.

        Returns:
            (B, 32, h, w) twice, h = 4 * ceil(H / 16), w = 4 * ceil(W / 16): at 1/4 of the image's
            size.
        """
        quarter = self.layer1(torch.relu(self.bn1(self.conv1(images))))
        eighth = self.layer2(quarter)
        features = self.iconv3(_beside(eighth, self.upconv3(self.layer3(eighth))))
        features = self.iconv2(_beside(quarter, self.upconv2(features)))
        coarse, fine = self.out_conv(features).split(WIDTH_EACH, dim=1)
        return coarse, fine


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with a shortcut."""

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
        larger = functional.interpolate(
            features, scale_factor=2, mode="bilinear", align_corners=True
        )
        convolved: Tensor = self.conv(larger)
        return convolved


def _beside(skipped: Tensor, upsampled: Tensor) -> Tensor:
    """Both in one tensor of the upsampled one's size.

    Zeros around the skipped one where a side was odd on the way down.
    """
    missing = [upsampled.shape[axis] - skipped.shape[axis] for axis in (3, 2)]
    borders = [border for gap in missing for border in (gap // 2, gap - gap // 2)]
    return torch.cat([upsampled, functional.pad(skipped, borders)], dim=1)


def _stage(width_in: int, width: int, blocks: int) -> nn.Sequential:
    first = ResidualBlock(width_in, width, stride=2)
    return nn.Sequential(first, *(ResidualBlock(width, width, stride=1) for _ in range(blocks - 1)))


def _convolution(
    width_in: int, width: int, size: int, stride: int = 1, bias: bool = True
) -> nn.Conv2d:
    return nn.Conv2d(
        width_in, width, size, stride, padding=size // 2, padding_mode="reflect", bias=bias
    )


@dataclass(frozen=True)
class IbrnetShape:
    """Shape of the networks, and how finely a ray is sampled.

    Attributes:
        width: channels of the feature network's first stage.
        blocks: residual blocks of its stages.
        samples: of the coarse pass of a ray; the fine pass adds as many.
    """

    width: int = 64
    blocks: tuple[int, int, int] = (3, 4, 6)
    samples: int = 64


CONFIGURATIONS = {"full": IbrnetShape(), "compact": IbrnetShape(16, (2, 2, 2), 32)}


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
    """Return the networks of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint, a dict with ``net_coarse``, ``net_fine`` and ``feature_net``,
            or safetensors whose names begin so.
    """
    networks = Networks(configuration_of(path, CONFIGURATIONS, "IBRNet") or FULL)
    for part in PARTS:
        model = f"IBRNet's {part}"
        load_strict(
            read_tensors(path, part, model=model), networks.get_submodule(part), path, model
        )
    return networks.eval().requires_grad_(False)


class RayNetwork(nn.Module):
    """Pools the views at each sample, lets the samples of a ray attend to each other, and blends
    the views' colours.
    """

    def __init__(self) -> None:
        super().__init__()
        self.s = nn.Parameter(torch.tensor(0.2))
        self.ray_dir_fc = _layers(4, 16, SEEN, last=nn.ELU(inplace=True))
        self.base_fc = _layers(3 * SEEN, 64, 32, last=nn.ELU(inplace=True))
        self.vis_fc = _layers(32, 32, 33, last=nn.ELU(inplace=True))
        self.vis_fc2 = _layers(32, 32, 1, last=nn.Sigmoid())
        self.geometry_fc = _layers(65, 64, WIDTH, last=nn.ELU(inplace=True))
        self.ray_attention = RayAttention()
        self.out_geometry_fc = _layers(WIDTH, 16, 1, last=nn.ReLU())
        self.rgb_fc = _layers(37, 16, 8, 1)

    def forward(
        self, view_features: Tensor, directions: Tensor, visible: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the colour and density of each sample.

        Args:
            view_features: RGB in [0, 1] and 32 features of each view, (R, S, K, 35), samples in the
                order of the ray.
            directions: unit difference of the target's and the view's ray, and their dot product,
                (R, S, K, 4).
            visible: whether the sample is in the view's image, (R, S, K, 1), bool.

        Returns:
            RGB, (R, S, 3), and density per sample, not per length, (R, S).
        """
        mask = visible.to(view_features.dtype)
        features, visibility = self._per_view(view_features, directions, mask)
        weights = visibility / (visibility.sum(dim=2, keepdim=True) + EPSILON)
        mean, variance = weighted_moments(features, weights)
        # (R, S, 65)
        pooled = torch.cat([mean, variance, weights.mean(dim=2, keepdim=True)], dim=-1)[:, :, 0]
        density = self._density(pooled, visible.sum(dim=2))
        scores = self.rgb_fc(torch.cat([features, visibility, directions], dim=-1)).masked_fill(
            ~visible, -1e9
        )
        return (torch.softmax(scores, dim=2) * view_features[..., :3]).sum(dim=2), density

    def _per_view(
        self, view_features: Tensor, directions: Tensor, mask: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the features (R, S, K, 32) and visibility (R, S, K, 1) of each view, each knowing
        what the others see.
        """
        features = view_features + self.ray_dir_fc(directions)
        weights = self._direction_weights(directions[..., 3:], mask)
        features = self._base(torch.cat(weighted_moments(features, weights), dim=-1), features)
        residual, visibility = self.vis_fc(features * weights).split([32, 1], dim=-1)
        features = features + residual
        return features, self.vis_fc2(features * (torch.sigmoid(visibility) * mask)) * mask

    def _base(self, pooled: Tensor, features: Tensor) -> Tensor:
        """`base_fc` of both side by side, (R, S, K, 32).

        What the views share, (R, S, 1, 70), is multiplied once for all.
        """
        of_pooled, of_features = self.base_fc.get_parameter("0.weight").split(
            [2 * SEEN, SEEN], dim=1
        )
        shared = functional.linear(pooled, of_pooled, self.base_fc.get_parameter("0.bias"))
        hidden: Tensor = self.base_fc[1:](functional.linear(features, of_features) + shared)
        return hidden

    def _direction_weights(self, dots: Tensor, mask: Tensor) -> Tensor:
        """Views that look along the target's ray weigh most, the worst one nothing ("anti-alias
        pooling"), (R, S, K, 1).
        """
        closeness = torch.exp(self.s.abs() * (dots - 1))
        weights = (closeness - closeness.amin(dim=2, keepdim=True)) * mask
        return weights / (weights.sum(dim=2, keepdim=True) + EPSILON)

    def _density(self, pooled: Tensor, views: Tensor) -> Tensor:
        """Return the density (R, S) from pooled features (R, S, 65) and the number of views that
        see each sample, (R, S, 1).
        """
        samples = self.geometry_fc(pooled)
        samples = samples + positions(samples.shape[1]).to(samples)
        density = self.out_geometry_fc(self.ray_attention(samples, views > 1))
        return density.masked_fill(views < 1, 0.0)[..., 0]


class RayAttention(nn.Module):
    """Self-attention of four heads over the samples of a ray, added to them and normalised."""

    def __init__(self) -> None:
        super().__init__()
        self.w_qs = nn.Linear(WIDTH, WIDTH, bias=False)
        self.w_ks = nn.Linear(WIDTH, WIDTH, bias=False)
        self.w_vs = nn.Linear(WIDTH, WIDTH, bias=False)
        self.fc = nn.Linear(WIDTH, WIDTH, bias=False)
        self.layer_norm = nn.LayerNorm(WIDTH, eps=1e-6)

    def forward(self, samples: Tensor, attends: Tensor) -> Tensor:
        """(R, S, 16) to (R, S, 16).

        A sample that does not attend, (R, S, 1) False, takes the mean of all.
        """
        rays, count, _ = samples.shape
        queries, keys, values = (
            projection(samples).view(rays, count, HEADS, -1).transpose(1, 2)  # (R, heads, S, 4)
            for projection in (self.w_qs, self.w_ks, self.w_vs)
        )
        asking = queries * attends[:, None]  # equal scores of all keys where nothing is asked
        mixed = (
            functional.scaled_dot_product_attention(asking, keys, values)
            .transpose(1, 2)
            .reshape(rays, count, WIDTH)
        )
        normalised: Tensor = self.layer_norm(self.fc(mixed) + samples)
        return normalised


def weighted_moments(features: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean and variance over the views: (R, S, K, C) and weights (R, S, K, 1) to (R, S,
    1, C) twice.
    """
    mean = (features * weights).sum(dim=2, keepdim=True)
    return mean, (weights * (features - mean) ** 2).sum(dim=2, keepdim=True)


def positions(count: int) -> Tensor:
    """Sinusoids that distinguish the samples of a ray (Vaswani et al. 2017), (1, count, 16),
    float64.
    """
    channel = torch.arange(WIDTH, dtype=torch.float64)
    rates = 10000.0 ** (-2 * torch.div(channel, 2, rounding_mode="floor") / WIDTH)
    angles = torch.arange(count, dtype=torch.float64)[:, None] * rates
    return torch.where(channel % 2 == 0, torch.sin(angles), torch.cos(angles))[None]


def _layers(*widths: int, last: nn.Module | None = None) -> nn.Sequential:
    """Return the linear layers with ELU between them and `last` behind them."""
    layers: list[nn.Module] = []
    for width_in, width in pairwise(widths):
        layers += [nn.Linear(width_in, width), nn.ELU(inplace=True)]
    return nn.Sequential(*layers[:-1], *([] if last is None else [last]))
