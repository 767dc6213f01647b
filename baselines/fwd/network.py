"""FWD as a whole: features of each view, adapted to the target's direction, fused and decoded at twice the size; its weights."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

from ggvs_eval.baselines.fwd.layers import VALUE_WIDTH, DepthCompletion, Resampling, ResidualBlock, ViewFusion
from ggvs_eval.baselines.learned import FULL
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors

DECODER_SIZES: tuple[Resampling, ...] = ("same", "down", "same", "same", "up", "same", "up", "same")
POINTS_PER_PIXEL = 24  # the nearest of those whose disc covers the pixel; the published code takes 16 where it learns depth
DIRECTION_WIDTH = 4  # unit difference of two viewing directions, and their cosine
OF = "FWD (this project's names)"


@dataclass(frozen=True)
class FwdOptions:
    """Widths of the network.

    Attributes:
        width: channels of a point: those of the encoder beside its colour.
        encoder: channels before the last block of the encoder.
        direction: channels of the change of direction.
        decoder: channels between the eight blocks of the decoder.
        value: channels of a head of the fusion.
        points_per_pixel: most points that a view blends at a pixel.
    """

    width: int = 64
    encoder: tuple[int, ...] = (32, 64, 64)
    direction: tuple[int, int] = (16, 32)
    decoder: tuple[int, ...] = (64, 128, 256, 256, 128, 128, 128)
    value: int = VALUE_WIDTH
    points_per_pixel: int = POINTS_PER_PIXEL


CONFIGURATIONS = {
    "full": FwdOptions(),
    "compact": FwdOptions(32, (16, 24, 24), (8, 16), (32, 48, 64, 64, 48, 32, 16), 16, 8),
}


class FwdNetwork(nn.Module):
    """The network; names of its parameters are ours.

    Reading:
        The encoder keeps the size; its widths between 3 and 61 are ours. Normalisation is by batch.
    """

    def __init__(self, configuration: str = "full", completes_depth: bool = False) -> None:
        super().__init__()
        self.configuration = configuration
        self.config = config = CONFIGURATIONS[configuration]
        encoder = (3, *config.encoder, config.width - 3)
        decoder = (config.width, *config.decoder, 3)
        first, second = config.direction
        self.completion = DepthCompletion() if completes_depth else None
        self.encoder = nn.Sequential(*(ResidualBlock(before, after) for before, after in pairwise(encoder)))
        self.direction = nn.Sequential(nn.Conv2d(DIRECTION_WIDTH, first, 1), nn.ReLU(), nn.Conv2d(first, second, 1), nn.ReLU())
        self.adaptation = nn.Sequential(
            nn.Conv2d(config.width + second, config.width, 1), nn.ReLU(), nn.Conv2d(config.width, config.width, 1)
        )
        self.fusion = ViewFusion(config.width, config.value)
        self.decoder = nn.Sequential(
            *(ResidualBlock(before, after, size) for (before, after), size in zip(pairwise(decoder), DECODER_SIZES, strict=True))
        )

    def view_features(self, images: Tensor, directions: Tensor) -> Tensor:
        """Features of each pixel as seen from the target.

        Args:
            images: (B, 3, H, W) in [-1, 1].
            directions: how the viewing direction changes from the source to the target, (B, 4, H, W), see `direction_change`.

        Returns:
            (B, width, H, W).
        """
        own = torch.cat([self.encoder(images), images], dim=1)
        adapted: Tensor = self.adaptation(torch.cat([own, self.direction(directions)], dim=1))
        return adapted

    def decode(self, features: Tensor, alphas: Tensor) -> Tensor:
        """The image that several warped views make together.

        Args:
            features: of each view, (K, width, h, w), h and w even.
            alphas: coverage by each view, (K, h, w).

        Returns:
            (3, 2 h, 2 w) in [-1, 1].
        """
        fused = self.fusion(features, alphas)
        return torch.tanh(self.decoder(fused[None])[0])


def direction_change(to_source: Tensor, to_target: Tensor) -> Tensor:
    """Compute the change of viewing direction from one camera to another, for each point.

    Args:
        to_source: from the source camera to each point, (N, 3), any length above 0.
        to_target: from the target camera to it, (N, 3).

    Returns:
        The unit difference of both directions (0 where they agree) and their cosine, (N, 4).
    """
    source, target = (torch.nn.functional.normalize(towards, dim=1) for towards in (to_source, to_target))
    difference = torch.nn.functional.normalize(source - target, dim=1, eps=1e-6)
    return torch.cat([difference, (source * target).sum(dim=1, keepdim=True)], dim=1)


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> FwdNetwork:
    """The network of a weights file, in evaluation mode, on a device.

    Whether it completes depth is known from its tensors, which configuration it is from its header.
    """
    tensors = read_tensors(path, of=OF)
    configuration = configuration_of(path, CONFIGURATIONS, OF) or FULL
    network = FwdNetwork(configuration, any(name.startswith("completion.") for name in tensors))
    load_strict(tensors, network, path, OF)
    return network.eval().to(device)
