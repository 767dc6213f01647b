"""Fuses what several views show at a pixel by attention from a learned token."""

import torch
from torch import Tensor, nn

HEADS, KEY_WIDTH, VALUE_WIDTH = 4, 16, 64  # widths are those of one head
PIXELS_AT_ONCE = 16384
UNSEEN = -1e9  # added to the logit of a view that shows nothing; where none shows anything, all weigh the same


class ViewFusion(nn.Module):
    """Multi-head attention over views, pixel by pixel; any number of views, in any order.

    Args:
        width: channels of a view's features.
        value_width: channels that a head carries on.

    Reading:
        The token is added to what the heads give, then a layer normalisation follows. A view without a point at a pixel is left
        out there.
    """

    def __init__(self, width: int, value_width: int = VALUE_WIDTH) -> None:
        super().__init__()
        self.value_width = value_width
        self.token = nn.Parameter(torch.randn(width) * width**-0.5)
        self.query = nn.Linear(width, HEADS * KEY_WIDTH, bias=False)
        self.key = nn.Linear(width, HEADS * KEY_WIDTH, bias=False)
        self.value = nn.Linear(width, HEADS * value_width, bias=False)
        self.out = nn.Linear(HEADS * value_width, width, bias=False)
        self.norm = nn.LayerNorm(width)

    def forward(self, features: Tensor, alphas: Tensor) -> Tensor:
        """Fuse views.

        Args:
            features: of each view, (K, C, H, W).
            alphas: coverage by each view, (K, H, W).

        Returns:
            (C, H, W).
        """
        views, width, *size = features.shape
        pixels = features.view(views, width, -1).permute(2, 0, 1)  # (P, K, C)
        unseen = (alphas.view(views, -1).T <= 0).float() * UNSEEN  # (P, K)
        chunks = zip(pixels.split(PIXELS_AT_ONCE), unseen.split(PIXELS_AT_ONCE), strict=True)
        return torch.cat([self._fuse(*chunk) for chunk in chunks]).T.reshape(width, *size)

    def _fuse(self, pixels: Tensor, unseen: Tensor) -> Tensor:
        """(P, K, C) and what is added to the logits, (P, K), to (P, C)."""
        count, views, _ = pixels.shape
        query = self.query(self.token).view(HEADS, KEY_WIDTH) * KEY_WIDTH**-0.5
        keys = self.key(pixels).view(count, views, HEADS, KEY_WIDTH)
        logits = (keys * query).sum(dim=-1) + unseen[..., None]  # (P, K, HEADS)
        shares = torch.softmax(logits, dim=1)
        values = self.value(pixels).view(count, views, HEADS, self.value_width)
        mixed = (shares[..., None] * values).sum(dim=1)  # (P, HEADS, self.value_width)
        fused: Tensor = self.norm(self.out(mixed.flatten(1)) + self.token)
        return fused
