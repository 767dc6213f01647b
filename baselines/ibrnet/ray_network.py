"""Density and colour of the samples of a ray from what the source views show there (IBRNet, its Fig. 3).

Names of modules are those of the published checkpoint.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTH = 16  # of a sample's density feature
HEADS = 4  # of the attention along a ray
SEEN = 35  # colour and features of one view at one sample
EPSILON = 1e-8


class RayNetwork(nn.Module):
    """Pools the views at each sample, lets the samples of a ray attend to each other, and blends the views' colours."""

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

    def forward(self, view_features: Tensor, directions: Tensor, visible: Tensor) -> tuple[Tensor, Tensor]:
        """Colour and density of each sample.

        Args:
            view_features: RGB in [0, 1] and 32 features of each view, (R, S, K, 35), samples in the order of the ray.
            directions: unit difference of the target's and the view's ray, and their dot product, (R, S, K, 4).
            visible: whether the sample lies in the view's image, (R, S, K, 1), bool.

        Returns:
            RGB, (R, S, 3), and density per sample, not per length, (R, S).
        """
        mask = visible.to(view_features.dtype)
        features, visibility = self._per_view(view_features, directions, mask)
        weights = visibility / (visibility.sum(dim=2, keepdim=True) + EPSILON)
        mean, variance = weighted_moments(features, weights)
        pooled = torch.cat([mean, variance, weights.mean(dim=2, keepdim=True)], dim=-1)[:, :, 0]  # (R, S, 65)
        density = self._density(pooled, visible.sum(dim=2))
        scores = self.rgb_fc(torch.cat([features, visibility, directions], dim=-1)).masked_fill(~visible, -1e9)
        return (torch.softmax(scores, dim=2) * view_features[..., :3]).sum(dim=2), density

    def _per_view(self, view_features: Tensor, directions: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Features (R, S, K, 32) and visibility (R, S, K, 1) of each view, each knowing what the others see."""
        features = view_features + self.ray_dir_fc(directions)
        weights = self._direction_weights(directions[..., 3:], mask)
        features = self._base(torch.cat(weighted_moments(features, weights), dim=-1), features)
        residual, visibility = self.vis_fc(features * weights).split([32, 1], dim=-1)
        features = features + residual
        return features, self.vis_fc2(features * (torch.sigmoid(visibility) * mask)) * mask

    def _base(self, pooled: Tensor, features: Tensor) -> Tensor:
        """`base_fc` of both beside each other, (R, S, K, 32); what the views share, (R, S, 1, 70), is multiplied once for all."""
        of_pooled, of_features = self.base_fc.get_parameter("0.weight").split([2 * SEEN, SEEN], dim=1)
        shared = functional.linear(pooled, of_pooled, self.base_fc.get_parameter("0.bias"))
        hidden: Tensor = self.base_fc[1:](functional.linear(features, of_features) + shared)
        return hidden

    def _direction_weights(self, dots: Tensor, mask: Tensor) -> Tensor:
        """Views that look along the target's ray weigh most, the worst one nothing ("anti-alias pooling"), (R, S, K, 1)."""
        closeness = torch.exp(self.s.abs() * (dots - 1))
        weights = (closeness - closeness.amin(dim=2, keepdim=True)) * mask
        return weights / (weights.sum(dim=2, keepdim=True) + EPSILON)

    def _density(self, pooled: Tensor, views: Tensor) -> Tensor:
        """Density (R, S) from pooled features (R, S, 65) and the number of views that see each sample, (R, S, 1)."""
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
        """(R, S, 16) to (R, S, 16); a sample that does not attend, (R, S, 1) False, takes the mean of all."""
        rays, count, _ = samples.shape
        queries, keys, values = (
            projection(samples).view(rays, count, HEADS, -1).transpose(1, 2)  # (R, heads, S, 4)
            for projection in (self.w_qs, self.w_ks, self.w_vs)
        )
        asking = queries * attends[:, None]  # equal scores of all keys where nothing is asked
        mixed = functional.scaled_dot_product_attention(asking, keys, values).transpose(1, 2).reshape(rays, count, WIDTH)
        normalised: Tensor = self.layer_norm(self.fc(mixed) + samples)
        return normalised


def weighted_moments(features: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and variance over the views: (R, S, K, C) and weights (R, S, K, 1) to (R, S, 1, C) twice."""
    mean = (features * weights).sum(dim=2, keepdim=True)
    return mean, (weights * (features - mean) ** 2).sum(dim=2, keepdim=True)


def positions(count: int) -> Tensor:
    """Sinusoids that tell the samples of a ray apart (Vaswani et al. 2017), (1, count, 16), float64."""
    channel = torch.arange(WIDTH, dtype=torch.float64)
    rates = 10000.0 ** (-2 * torch.div(channel, 2, rounding_mode="floor") / WIDTH)
    angles = torch.arange(count, dtype=torch.float64)[:, None] * rates
    return torch.where(channel % 2 == 0, torch.sin(angles), torch.cos(angles))[None]


def _layers(*widths: int, last: nn.Module | None = None) -> nn.Sequential:
    """Linear layers with ELU between them and `last` behind them."""
    layers: list[nn.Module] = []
    for width_in, width in pairwise(widths):
        layers += [nn.Linear(width_in, width), nn.ELU(inplace=True)]
    return nn.Sequential(*layers[:-1], *([] if last is None else [last]))
