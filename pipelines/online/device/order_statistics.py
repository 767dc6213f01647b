"""Medians whose result stays on the device: torch's own read it back, or take at most 16 million values."""

import torch
from torch import Tensor


def masked_median(values: Tensor, mask: Tensor) -> Tensor:
    """Median over the second axis of what counts, the mean of the two middle values of an even number.

    Args:
        values: (P, N, C).
        mask: what counts, (P, N, 1).

    Returns:
        (P, C), 0 where nothing counts.
    """
    ordered = torch.where(mask, values, torch.inf).sort(dim=1).values
    count = mask.sum(dim=1).expand(-1, values.shape[2])
    places = (count - 1).clamp(min=0) // 2, (count // 2).clamp(max=values.shape[1] - 1)
    low, high = (ordered.gather(1, place[:, None])[:, 0] for place in places)
    return torch.where(count > 0, (low + high) / 2, 0.0)
