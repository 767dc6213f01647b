"""Depth of every pixel by cost volumes between the views, and what the network says of its Gaussian
('depth_predictor').
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.contrib.more_baselines.mvsplat.backbone import SCALE
from ggvs_eval.contrib.more_baselines.mvsplat.views import Views

GROUPS = 8  # of the normalisations
HEAD_WIDTH = 32  # channels of an attention's head; fewer where the whole has fewer


class ResidualUnit(nn.Module):
    """Two convolutions, each normalised after it, with a shortcut."""

    def __init__(self, width_in: int, width: int) -> None:
        super().__init__()
        self.in_layers = nn.Sequential(
            nn.Conv2d(width_in, width, 3, padding=1), nn.GroupNorm(GROUPS, width), nn.SiLU()
        )
        self.out_layers = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1), _silent(width), nn.SiLU()
        )
        self.skip_connection = nn.Identity() if width_in == width else nn.Conv2d(width_in, width, 1)

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w) to (K, width, h, w)."""
        changed: Tensor = self.out_layers(self.in_layers(features))
        return self.skip_connection(features) + changed


class JointAttention(nn.Module):
    """Every cell of every view looks at every cell of every view."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.heads = max(width // HEAD_WIDTH, 1)
        self.qkv = nn.Conv1d(width, 3 * width, 1)
        self.proj_out = nn.Conv1d(width, width, 1)
        self.norm = _silent(width)

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w), of any number of views."""
        count, channels, height, width = features.shape
        cells = features.flatten(2)  # (K, C, h * w)
        # heads first, then q, k, v
        joined = self.qkv(cells).transpose(0, 1).reshape(self.heads, 3, channels // self.heads, -1)
        # (1, heads, K * h * w, C')
        query, key, value = (part.transpose(-1, -2)[None].contiguous() for part in joined.unbind(1))
        attended = functional.scaled_dot_product_attention(query, key, value)
        apart = (
            attended[0].transpose(-1, -2).reshape(channels, count, height * width).transpose(0, 1)
        )
        changed: Tensor = self.norm(self.proj_out(apart))
        return (cells + changed).reshape(features.shape)


class Halving(nn.Module):
    """A convolution that halves both sides."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.op = nn.Conv2d(width, width, 3, stride=2, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w) to (K, C, h / 2, w / 2)."""
        halved: Tensor = self.op(features)
        return halved


class Doubling(nn.Module):
    """Each cell four times, then a convolution."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w) to (K, C, 2 h, 2 w)."""
        doubled: Tensor = self.conv(
            functional.interpolate(features, scale_factor=2, mode="nearest")
        )
        return doubled


class UNet(nn.Module):
    """One residual unit on each level down, two on each level up.

    Args:
        levels: each after the first at half the previous size.
    """

    def __init__(self, width: int, levels: int) -> None:
        super().__init__()
        lowest = levels - 1
        self.input_blocks = nn.ModuleList([nn.Sequential(nn.Conv2d(width, width, 3, padding=1))])
        self.output_blocks = nn.ModuleList()
        for level in range(levels):
            attention = [JointAttention(width)] if level == lowest else []
            self.input_blocks.append(nn.Sequential(ResidualUnit(width, width), *attention))
            if level != lowest:
                self.input_blocks.append(nn.Sequential(Halving(width)))
        self.middle_block = nn.Sequential(
            ResidualUnit(width, width), nn.Identity(), ResidualUnit(width, width)
        )
        for level in reversed(range(levels)):
            for last in (False, True):
                attention = [JointAttention(width)] if level == lowest else []
                doubling = [Doubling(width)] if last and level else []
                self.output_blocks.append(
                    nn.Sequential(ResidualUnit(2 * width, width), *attention, *doubling)
                )
        self.out = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1), nn.GroupNorm(GROUPS, width), nn.SiLU()
        )

    def forward(self, features: Tensor) -> Tensor:
        """(K, C, h, w) of all views, h and w multiples of 2**(levels - 1)."""
        shortcuts = []
        for block in self.input_blocks:
            features = block(features)
            shortcuts.append(features)
        features = self.middle_block(features)
        for block in self.output_blocks:
            features = block(torch.cat([features, shortcuts.pop()], dim=1))
        last: Tensor = self.out(features)
        return last


def _silent(width: int) -> nn.GroupNorm:
    """Return a normalisation that gives nothing at first, so that the network begins with its
    shortcuts.
    """
    norm = nn.GroupNorm(GROUPS, width)
    nn.init.zeros_(norm.weight)
    return norm


OFFSET, SCALES, QUATERNION = 2, 3, 4  # channels of a Gaussian before those of its colour
COST_LEVELS, REFINEMENT_LEVELS = 3, 5  # of the U-Nets
COST_GROUPS, REFINEMENT_GROUPS = 8, 4  # of the normalisations before them
SMALLEST_Z = 1e-3  # what is nearer to another view, or behind it, is outside
MOST_AT_ONCE = 2**23  # warped features, which bounds the memory


class PixelMaps(NamedTuple):
    """Raw output of the network.

    Attributes:
        coarse_disparity: expectation under the cost volume, per unit of length, (K, 1, H, W).
        disparity: the refined one, within the searched range, (K, 1, H, W).
        opacity_logit: (K, 1, H, W).
        shape: offset in the pixel 2, scale 3, quaternion 4 with its real part last, harmonics of
            red, then of green, then of blue; before their activations, (K, 2 + 3 + 4 + 3 * terms,
            H, W).
    """

    coarse_disparity: Tensor
    disparity: Tensor
    opacity_logit: Tensor
    shape: Tensor


class DepthPredictor(nn.Module):
    """Cost volumes, their refinement, and the heads at full resolution."""

    def __init__(
        self,
        width: int,
        candidates: int,
        cost_width: int,
        refinement_width: int,
        shape_channels: int,
    ) -> None:
        super().__init__()
        self.candidates = candidates
        self.corr_refine_net = nn.Sequential(
            _convolution(candidates + width, cost_width),
            nn.GroupNorm(COST_GROUPS, cost_width),
            nn.GELU(),
            UNet(cost_width, COST_LEVELS),
            _convolution(cost_width, candidates),
        )
        self.regressor_residual = nn.Conv2d(candidates + width, candidates, 1)
        self.depth_head_lowres = _head(candidates, 2 * candidates, candidates)
        self.upsampler = nn.Sequential(
            _convolution(2 * width, width),
            nn.Upsample(scale_factor=SCALE, mode="bilinear", align_corners=True),
            nn.GELU(),
        )
        self.proj_feature = _convolution(width, refinement_width)
        self.refine_unet = nn.Sequential(
            _convolution(3 + refinement_width + 2, refinement_width),
            nn.GroupNorm(REFINEMENT_GROUPS, refinement_width),
            nn.GELU(),
            UNet(refinement_width, REFINEMENT_LEVELS),
        )
        self.to_gaussians = _head(refinement_width + 3 + width, 2 * shape_channels, shape_channels)
        self.to_disparity = _head(refinement_width, 2 * refinement_width, 2)

    def forward(self, together: Tensor, alone: Tensor, views: Views) -> PixelMaps:
        """Regress a Gaussian per pixel of every view.

        Args:
            together: features that know of the other views, (K, C, H / 4, W / 4).
            views: at least two.
        """
        images = views.images
        coarse, certainty = self.search(together, views)
        pairs = torch.cat([together, alone], dim=1)
        # view by view: memory
        projected = torch.cat([self.proj_feature(self.upsampler(pair)) for pair in pairs.split(1)])
        refined = self.refine_unet(torch.cat([images, projected, coarse, certainty], dim=1))
        change, opacity_logit = self.to_disparity(refined).float().split(1, dim=1)
        disparity = (coarse + change).clamp(1 / views.far, 1 / views.near)
        parts = zip(refined.split(1), images.split(1), pairs.split(1), strict=True)
        shape = torch.cat(
            [
                self.to_gaussians(torch.cat([part, image, self.upsampler(pair)], dim=1)).float()
                for part, image, pair in parts
            ]
        )
        return PixelMaps(
            coarse_disparity=coarse, disparity=disparity, opacity_logit=opacity_logit, shape=shape
        )

    def search(self, together: Tensor, views: Views) -> tuple[Tensor, Tensor]:
        """Return the inverse depth that the cost volumes expect, and the largest share of a
        candidate, both (K, 1, H, W).
        """
        disparities = torch.linspace(1 / views.far, 1 / views.near, self.candidates)
        volume = torch.cat(
            [correlations(together.float(), views, disparities).to(together.dtype), together], dim=1
        )
        costs = self.corr_refine_net(volume) + self.regressor_residual(volume)
        shares = torch.softmax(self.depth_head_lowres(costs).float(), dim=1)  # (K, D, H / 4, W / 4)
        expected = (shares * disparities[:, None, None]).sum(dim=1, keepdim=True)
        return (
            functional.interpolate(
                expected, scale_factor=SCALE, mode="bilinear", align_corners=True
            ),
            functional.interpolate(
                shares.amax(dim=1, keepdim=True), scale_factor=SCALE, mode="nearest"
            ),
        )


def correlations(features: Tensor, views: Views, disparities: Tensor) -> Tensor:
    """Cost volumes: how alike a view's feature and those of the others are on planes before it, the
    mean over the others.

    Args:
        features: (K, C, h, w).
        views: where they were seen from, at least two.
        disparities: inverse z of the planes, (D,).

    Returns:
        (K, D, h, w): dot products over the root of C; 0 where another view does not see the place.
    """
    count, channels, height, width = features.shape
    sums = features.new_zeros(count, len(disparities), height, width)
    rows, columns = torch.meshgrid(
        *(torch.arange(side, dtype=torch.float32) for side in (height, width)), indexing="ij"
    )
    cells = torch.stack([columns, rows, torch.ones_like(rows)], dim=-1)  # (h, w, 3)
    last = features.new_tensor([width - 1, height - 1])
    at_once = max(MOST_AT_ONCE // features[0].numel(), 1)
    for view in range(count):
        for partner in (index for index in range(count) if index != view):
            turn, shift = (
                torch.as_tensor(part).float() for part in _homography(views, view, partner)
            )
            rays = cells @ turn.T
            similar = []
            for depths in (1 / disparities).split(at_once):
                points = rays * depths[:, None, None, None] + shift  # (d, h, w, 3)
                places = 2 * points[..., :2] / points[..., 2:].clamp(min=SMALLEST_Z) / last - 1
                warped = _look_up(features[partner], places.reshape(-1, width, 2))
                alike = warped.reshape(channels, -1, height, width) * features[view, :, None]
                similar.append(alike.sum(dim=0))
            sums[view] = sums[view] + torch.cat(similar)
    return sums / (channels**0.5 * (count - 1))


def _look_up(features: Tensor, places: Tensor) -> Tensor:
    """Return the features (C, h, w) at places (H, W, 2) in [-1, 1], bilinear, 0 outside,
    (C, H, W).
    """
    return functional.grid_sample(
        features[None], places[None], mode="bilinear", padding_mode="zeros", align_corners=True
    )[0]


def _homography(views: Views, view: int, partner: int) -> tuple[np.ndarray, np.ndarray]:
    """Cell (x, y, 1) of a view at depth z to z' (x', y', 1) in another: ``turn @ cell * z +
    shift``.

    Reading:
        As the authors', cells are at whole numbers of intrinsics whose pixel centres are at halves;
        both views are off by the same eighth of a cell.
    """
    K, other_K = (np.diag([1 / SCALE, 1 / SCALE, 1]) @ views.K[index] for index in (view, partner))
    move = np.linalg.inv(views.camera_to_world[partner]) @ views.camera_to_world[view]
    return other_K @ move[:3, :3] @ np.linalg.inv(K), other_K @ move[:3, 3]


def _convolution(width_in: int, width: int) -> nn.Conv2d:
    return nn.Conv2d(width_in, width, 3, padding=1)


def _head(width_in: int, hidden: int, width: int) -> nn.Sequential:
    return nn.Sequential(_convolution(width_in, hidden), nn.GELU(), _convolution(hidden, width))
