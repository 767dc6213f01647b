"""FWD as a whole: features of each view, adapted to the target's direction, fused and decoded at twice the size."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from ggvs_eval.baselines.fwd.blocks import Resampling, ResidualBlock
from ggvs_eval.baselines.fwd.completion import DepthCompletion
from ggvs_eval.baselines.fwd.fusion import ViewFusion

WIDTH = 64  # channels of a point: 61 of the encoder beside its colour
ENCODER_WIDTHS = (3, 32, 64, 64, WIDTH - 3)
DECODER_WIDTHS = (WIDTH, 64, 128, 256, 256, 128, 128, 128, 3)
DECODER_SIZES: tuple[Resampling, ...] = ("same", "down", "same", "same", "up", "same", "up", "same")
DIRECTION_WIDTH = 4  # unit difference of two viewing directions, and their cosine


class FwdNetwork(nn.Module):
    """The network; names of its parameters are ours.

    Args:
        completes_depth: whether depth is completed before it is used.

    Reading:
        The encoder keeps the size; its widths between 3 and 61 are ours. Normalisation is by batch.
    """

    def __init__(self, completes_depth: bool = False) -> None:
        super().__init__()
        self.completion = DepthCompletion() if completes_depth else None
        self.encoder = nn.Sequential(*(ResidualBlock(before, after) for before, after in pairwise(ENCODER_WIDTHS)))
        self.direction = nn.Sequential(nn.Conv2d(DIRECTION_WIDTH, 16, 1), nn.ReLU(), nn.Conv2d(16, 32, 1), nn.ReLU())
        self.adaptation = nn.Sequential(nn.Conv2d(WIDTH + 32, WIDTH, 1), nn.ReLU(), nn.Conv2d(WIDTH, WIDTH, 1))
        self.fusion = ViewFusion(WIDTH)
        self.decoder = nn.Sequential(
            *(
                ResidualBlock(before, after, size)
                for (before, after), size in zip(pairwise(DECODER_WIDTHS), DECODER_SIZES, strict=True)
            )
        )

    def view_features(self, images: Tensor, directions: Tensor) -> Tensor:
        """Features of each pixel as seen from the target.

        Args:
            images: (B, 3, H, W) in [-1, 1].
            directions: how the viewing direction changes from the source to the target, (B, 4, H, W), see `direction_change`.

        Returns:
            (B, 64, H, W).
        """
        own = torch.cat([self.encoder(images), images], dim=1)
        adapted: Tensor = self.adaptation(torch.cat([own, self.direction(directions)], dim=1))
        return adapted

    def decode(self, features: Tensor, alphas: Tensor) -> Tensor:
        """The image that several warped views make together.

        Args:
            features: of each view, (K, 64, h, w), h and w even.
            alphas: coverage by each view, (K, h, w).

        Returns:
            (3, 2 h, 2 w) in [-1, 1].
        """
        fused = self.fusion(features, alphas)
        return torch.tanh(self.decoder(fused[None])[0])


def direction_change(to_source: Tensor, to_target: Tensor) -> Tensor:
    """How the viewing direction of points changes from one camera to another.

    Args:
        to_source: from the source camera to each point, (N, 3), any length above 0.
        to_target: from the target camera to it, (N, 3).

    Returns:
        The unit difference of both directions (0 where they agree) and their cosine, (N, 4).
    """
    source, target = (torch.nn.functional.normalize(towards, dim=1) for towards in (to_source, to_target))
    difference = torch.nn.functional.normalize(source - target, dim=1, eps=1e-6)
    return torch.cat([difference, (source * target).sum(dim=1, keepdim=True)], dim=1)
