"""Losses of stereo training."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional


def sequence_loss(flows: Sequence[Tensor], last: Tensor, truth: Tensor, decay: float = 0.9, largest_px: float = 700.0) -> Tensor:
    """Mean absolute error of every iteration's flow, later ones weighing more (RAFT-Stereo, section 3.4).

    Args:
        flows: after each of n iterations, in cells, (B, 1, h, w).
        last: the last one at full size, in pixels, (B, 1, H, W).
        truth: (B, 1, H, W), pixels.
        decay: weight of iteration i is decay**(15 / (n - 1) * (n - 1 - i)): the first one counts the same whatever n.

    Reading:
        The authors bring every iteration to full size; earlier ones count at their cells here, at a third less time a step.
    """
    factor = last.shape[-1] // flows[0].shape[-1]
    step, n = decay ** (15 / max(1, len(flows) - 1)), len(flows)
    at_cells = truth[..., ::factor, ::factor]
    errors = [factor * flow - at_cells for flow in flows[:-1]]
    weighted = [step ** (n - 1 - i) * _mean_absolute(error, at_cells, largest_px) for i, error in enumerate(errors)]
    return torch.stack([*weighted, _mean_absolute(last - truth, truth, largest_px)]).sum()


def _mean_absolute(error: Tensor, truth: Tensor, largest_px: float) -> Tensor:
    return error.abs()[truth.abs() < largest_px].mean()


def matching_loss(left: Tensor, right: Tensor, disparity: Tensor, visible: Tensor, factor: int) -> Tensor:
    """Cross entropy of the match that correlation alone would choose on the row, over cells whose match is seen.

    RAFT-Stereo trains its features through the recurrent unit alone, which takes many more steps than we have.

    Args:
        left: features, (B, C, h, w), float32.
        disparity: exact, (B, H, W), pixels.
        visible: which matches the right image shows, (B, H, W).
        factor: pixels per cell; features of a cell are centred on its first pixel.
    """
    logits = torch.einsum("bchw,bchv->bhwv", left, right) * left.shape[1] ** -0.5
    coarse = disparity[:, ::factor, ::factor] / factor
    width = coarse.shape[-1]
    column = torch.arange(width, device=left.device) - coarse  # (B, h, w)
    below = column.floor()
    share = column - below
    counted = visible[:, ::factor, ::factor] & (below >= 0) & (below < width - 1)
    index = below.clamp(0, width - 2).long()[..., None]
    chances = functional.log_softmax(logits, dim=-1)
    chance = (1 - share) * chances.gather(-1, index)[..., 0] + share * chances.gather(-1, index + 1)[..., 0]
    return -(chance * counted).sum() / counted.sum().clamp(min=1)
