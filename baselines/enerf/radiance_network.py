"""Density and colour of a sample from the cost volume's features and from what the source views show there.

Names of modules are those of the published checkpoint.
"""

import torch
from torch import Tensor, nn

VOXEL_WIDTH, POOLED_WIDTH, HIDDEN_WIDTH = 8, 16, 64


class RadianceNetwork(nn.Module):
    """Pools the views at each sample, and blends their colours.

    Args:
        feature_width: channels of a view's features, without colour.
    """

    def __init__(self, feature_width: int) -> None:
        super().__init__()
        known = VOXEL_WIDTH + POOLED_WIDTH
        self.agg = ViewPooling(feature_width + 3)
        self.lr0 = nn.Sequential(nn.Linear(known, HIDDEN_WIDTH), nn.ReLU())
        self.sigma = nn.Sequential(nn.Linear(HIDDEN_WIDTH, 1), nn.Softplus())
        self.color = nn.Sequential(
            nn.Linear(HIDDEN_WIDTH + known + feature_width + 3 + 4, HIDDEN_WIDTH),
            nn.ReLU(),
            nn.Linear(HIDDEN_WIDTH, 1),
            nn.ReLU(),
        )

    def forward(self, voxels: Tensor, seen: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        """Colour and density of each sample.

        Args:
            voxels: features of the cost volume there, (N, 8).
            seen: features of each view and, last, its RGB, (N, K, C + 3).
            directions: unit difference of the view's and the target's ray, and their dot product, (N, K, 4).

        Returns:
            RGB, (N, 3), and density per sample, not per length, (N,).
        """
        known = torch.cat([voxels, self.agg(seen, directions)], dim=-1)
        hidden = self.lr0(known)
        shared = torch.cat([hidden, known], dim=-1)[:, None].expand(-1, seen.shape[1], -1)
        shares = torch.softmax(self.color(torch.cat([shared, seen, directions], dim=-1)), dim=1)
        return (shares * seen[..., -3:]).sum(dim=1), self.sigma(hidden)[:, 0]


class ViewPooling(nn.Module):
    """One feature of all views: each knows mean and variance over all, then they are weighted.

    Args:
        width: channels of a view's features and colour.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.view_fc = nn.Sequential(nn.Linear(4, width), nn.ReLU())
        self.global_fc = nn.Sequential(nn.Linear(3 * width, 32), nn.ReLU())
        self.agg_w_fc = nn.Sequential(nn.Linear(32, 1), nn.ReLU())
        self.fc = nn.Sequential(nn.Linear(32, POOLED_WIDTH), nn.ReLU())

    def forward(self, seen: Tensor, directions: Tensor) -> Tensor:
        """(N, K, width) and (N, K, 4) to (N, 16); the variance is the unbiased one, so K >= 2."""
        features = seen + self.view_fc(directions)
        variance, mean = torch.var_mean(features, dim=1, keepdim=True)
        features = self.global_fc(torch.cat([features, variance.expand_as(seen), mean.expand_as(seen)], dim=-1))
        shares = torch.softmax(self.agg_w_fc(features), dim=1)
        pooled: Tensor = self.fc((features * shares).sum(dim=1))
        return pooled
