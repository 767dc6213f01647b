"""ENeRF's networks: a feature pyramid of each image, cost volumes, radiance of samples.

And where their weights come from.

Names of modules are those of the published checkpoint.
"""

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.baselines.learned import FULL
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors

VOXEL_WIDTH, POOLED_WIDTH, HIDDEN_WIDTH = 8, 16, 64
# Planes of the coarse volume: 64 of the published training, 32 of the authors' runs on real scenes.
COARSE_PLANES = {"full": 64, "compact": 32}


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
        """Return the features of three levels.

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


class CostNetwork(nn.Module):
    """A 3D U-Net.

    Args:
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
        """Return the features and score of each cell.

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


def _enlarging(width_in: int, width: int) -> nn.Sequential:
    """Return the transposed convolution to twice the size, normalised."""
    enlarged = nn.ConvTranspose3d(
        width_in, width, 3, stride=2, padding=1, output_padding=1, bias=False
    )
    return nn.Sequential(enlarged, nn.BatchNorm3d(width))


class RadianceNetwork(nn.Module):
    """Pools the views at each sample, and blends their colours.

    Args:
        feature_width: channels of a view's features, without colour.
    """

    def __init__(self, feature_width: int) -> None:
        super().__init__()
        sample_width = VOXEL_WIDTH + POOLED_WIDTH
        self.agg = ViewPooling(feature_width + 3)
        self.lr0 = nn.Sequential(nn.Linear(sample_width, HIDDEN_WIDTH), nn.ReLU())
        self.sigma = nn.Sequential(nn.Linear(HIDDEN_WIDTH, 1), nn.Softplus())
        self.color = nn.Sequential(
            nn.Linear(HIDDEN_WIDTH + sample_width + feature_width + 3 + 4, HIDDEN_WIDTH),
            nn.ReLU(),
            nn.Linear(HIDDEN_WIDTH, 1),
            nn.ReLU(),
        )

    def forward(
        self, voxels: Tensor, view_features: Tensor, directions: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the colour and density of each sample.

        Args:
            voxels: features of the cost volume there, (N, 8).
            view_features: features of each view and, last, its RGB, (N, K, C + 3).
            directions: unit difference of the view's and the target's ray, and their dot product,
                (N, K, 4).

        Returns:
            RGB, (N, 3), and density per sample, not per length, (N,).
        """
        sample_features = torch.cat([voxels, self.agg(view_features, directions)], dim=-1)
        hidden = self.lr0(sample_features)
        shared = torch.cat([hidden, sample_features], dim=-1)[:, None].expand(
            -1, view_features.shape[1], -1
        )
        shares = torch.softmax(
            self.color(torch.cat([shared, view_features, directions], dim=-1)), dim=1
        )
        return (shares * view_features[..., -3:]).sum(dim=1), self.sigma(hidden)[:, 0]


class ViewPooling(nn.Module):
    """One feature of all views: each knows mean and variance over all, then they are weighted."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.view_fc = nn.Sequential(nn.Linear(4, width), nn.ReLU())
        self.global_fc = nn.Sequential(nn.Linear(3 * width, 32), nn.ReLU())
        self.agg_w_fc = nn.Sequential(nn.Linear(32, 1), nn.ReLU())
        self.fc = nn.Sequential(nn.Linear(32, POOLED_WIDTH), nn.ReLU())

    def forward(self, view_features: Tensor, directions: Tensor) -> Tensor:
        """(N, K, width) and (N, K, 4) to (N, 16); the variance is the unbiased one, so K >= 2."""
        features = view_features + self.view_fc(directions)
        variance, mean = torch.var_mean(features, dim=1, keepdim=True)
        features = self.global_fc(
            torch.cat(
                [features, variance.expand_as(view_features), mean.expand_as(view_features)], dim=-1
            )
        )
        shares = torch.softmax(self.agg_w_fc(features), dim=1)
        pooled: Tensor = self.fc((features * shares).sum(dim=1))
        return pooled


class Networks(nn.Module):
    """All that is trained, under the names of the published checkpoint.

    `nerf_0` only serves the training.

    Args:
        configuration: ``full``, or ``compact``, which has the same weights and fewer planes.
    """

    def __init__(self, configuration: str = FULL) -> None:
        super().__init__()
        self.configuration = configuration
        self.coarse_planes = COARSE_PLANES[configuration]
        self.feature_net = FeatureNetwork()
        self.cost_reg_0 = CostNetwork(32, deep=False)
        self.nerf_0 = RadianceNetwork(32)
        self.cost_reg_1 = CostNetwork(16, deep=True)
        self.nerf_1 = RadianceNetwork(8)


def load_enerf(path: Path) -> Networks:
    """Return the networks of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint, a dict with ``net``, safetensors whose names begin so, or the
            output of `ggvs-eval train`.
    """
    configuration = configuration_of(path, COARSE_PLANES, "ENeRF")
    networks = Networks(configuration or FULL)
    tensors = read_tensors(path, *(() if configuration else ("net",)), model="ENeRF")
    load_strict(tensors, networks, path, "ENeRF")
    return networks.eval().requires_grad_(False)
