"""Where along its ray a target pixel is looked for: evenly in inverse depth, then where the first pass found something."""

import torch
from torch import Tensor

SMALLEST_SHARE = 1e-5


def coarse_depths(near: float, far: float, count: int) -> Tensor:
    """Depths from near to far, evenly spaced in inverse depth, (count,)."""
    step = (1 / far - 1 / near) / (count - 1)
    return 1 / (1 / near + torch.arange(count) * step)


def finer_depths(depths: Tensor, weights: Tensor, count: int) -> Tensor:
    """The depths of the first pass and as many more as asked for, drawn evenly from what it saw.

    Args:
        depths: of the first pass, (R, S), increasing.
        weights: share of each in its pixel's colour, (R, S).
        count: how many to add.

    Returns:
        (R, S + count), increasing.

    Reading:
        The distribution is constant between the middles of neighbouring samples, in inverse depth; the weights of the first and
        the last sample are left out.
    """
    inverse = 1 / depths
    middles = (inverse[:, 1:] + inverse[:, :-1]) / 2
    added = 1 / quantiles(middles.flip(1), weights[:, 1:-1].flip(1), count)
    return torch.cat([depths, added], dim=1).sort(dim=1).values


def quantiles(edges: Tensor, weights: Tensor, count: int) -> Tensor:
    """Evenly spaced quantiles, 0 to 1, of a distribution that is constant between edges.

    Args:
        edges: (R, M + 1), increasing.
        weights: of the M intervals, (R, M); a small constant is added to each.
        count: number of quantiles.

    Returns:
        (R, count), increasing.
    """
    shares = weights + SMALLEST_SHARE
    cumulative = torch.cumsum(shares / shares.sum(dim=1, keepdim=True), dim=1)
    cumulative = torch.cat([torch.zeros_like(cumulative[:, :1]), cumulative], dim=1)  # (R, M + 1)
    levels = torch.linspace(0, 1, count, device=edges.device).expand(edges.shape[0], count).contiguous()
    above = torch.searchsorted(cumulative[:, :-1].contiguous(), levels, right=True)  # (R, count), 1..M
    below = (above - 1).clamp(min=0)
    height = cumulative.gather(1, above) - cumulative.gather(1, below)
    height = torch.where(height < SMALLEST_SHARE, 1.0, height)
    along = (levels - cumulative.gather(1, below)) / height
    return edges.gather(1, below) + along * (edges.gather(1, above) - edges.gather(1, below))
