"""FWD as a whole: features of each view, adapted to the target's direction, fused and decoded at
twice the size; its weights.

Its parts are residual blocks after BigGAN, completion of depth, fusion of views by attention.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import spectral_norm

from ggvs_eval.baselines.learned import FULL
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors

Resampling = Literal["same", "down", "up"]
# of the completion: stride-2 levels, channels of the first, most channels of any
HALVINGS, WIDTH, WIDEST = 8, 32, 256
COMPLETED_MULTIPLE = 2**HALVINGS
SMALLEST_SHARE = 1e-4  # of the largest inverse depth; farther points would be at infinity
HEADS, KEY_WIDTH, VALUE_WIDTH = 4, 16, 64  # widths are those of one head
PIXELS_AT_ONCE = 16384  # that the fusion looks at
# added to the logit of a view that shows nothing; where none shows anything, all weigh the same
UNSEEN = -1e9
DECODER_SIZES: tuple[Resampling, ...] = ("same", "down", "same", "same", "up", "same", "up", "same")
# the nearest of those whose disc covers the pixel; the published code takes 16 where it learns
# depth
POINTS_PER_PIXEL = 24
DIRECTION_WIDTH = 4  # unit difference of two viewing directions, and their cosine
OF = "FWD (this project's names)"


@dataclass(frozen=True)
class FwdShape:
    """Widths of the network.

    Attributes:
        width: channels of a point: those of the encoder, besides its colour.
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
    "full": FwdShape(),
    "compact": FwdShape(
        width=32,
        encoder=(16, 24, 24),
        direction=(8, 16),
        decoder=(32, 48, 64, 64, 48, 32, 16),
        value=16,
        points_per_pixel=8,
    ),
}


class FwdNetwork(nn.Module):
    """The network; names of its parameters are chosen here.

    Reading:
        The encoder keeps the size; its widths between 3 and 61 are chosen here. Normalisation is by
        batch.
    """

    def __init__(self, configuration: str = "full", completes_depth: bool = False) -> None:
        super().__init__()
        self.configuration = configuration
        self.config = config = CONFIGURATIONS[configuration]
        encoder = (3, *config.encoder, config.width - 3)
        decoder = (config.width, *config.decoder, 3)
        first, second = config.direction
        self.completion = DepthCompletion() if completes_depth else None
        self.encoder = nn.Sequential(
            *(ResidualBlock(before, after) for before, after in pairwise(encoder))
        )
        self.direction = nn.Sequential(
            nn.Conv2d(DIRECTION_WIDTH, first, 1), nn.ReLU(), nn.Conv2d(first, second, 1), nn.ReLU()
        )
        self.adaptation = nn.Sequential(
            nn.Conv2d(config.width + second, config.width, 1),
            nn.ReLU(),
            nn.Conv2d(config.width, config.width, 1),
        )
        self.fusion = ViewFusion(config.width, config.value)
        self.decoder = nn.Sequential(
            *(
                ResidualBlock(before, after, size)
                for (before, after), size in zip(pairwise(decoder), DECODER_SIZES, strict=True)
            )
        )

    def view_features(self, images: Tensor, directions: Tensor) -> Tensor:
        """Return the features of each pixel as seen from the target.

        Args:
            images: (B, 3, H, W) in [-1, 1].
            directions: how the viewing direction changes from the source to the target, (B, 4, H,
                W), see `direction_change`.

        Returns:
            (B, width, H, W).
        """
        features = torch.cat([self.encoder(images), images], dim=1)
        adapted: Tensor = self.adaptation(torch.cat([features, self.direction(directions)], dim=1))
        return adapted

    def decode(self, features: Tensor, alphas: Tensor) -> Tensor:
        """Return the image that several warped views make together.

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
        The unit difference of both directions (0 if they agree) and their cosine, (N, 4).
    """
    source, target = (
        torch.nn.functional.normalize(towards, dim=1) for towards in (to_source, to_target)
    )
    difference = torch.nn.functional.normalize(source - target, dim=1, eps=1e-6)
    return torch.cat([difference, (source * target).sum(dim=1, keepdim=True)], dim=1)


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> FwdNetwork:
    """Return the network of a weights file, in evaluation mode, on a device.

    Whether it completes depth is known from its tensors, which configuration it is from its header.
    """
    tensors = read_tensors(path, model=OF)
    configuration = configuration_of(path, CONFIGURATIONS, OF) or FULL
    network = FwdNetwork(configuration, any(name.startswith("completion.") for name in tensors))
    load_strict(tensors, network, path, OF)
    return network.eval().to(device)


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions, each after normalisation and ReLU, with a 1x1 shortcut.

    Args:
        resampling: ``up`` doubles the size before the first convolution (nearest neighbour),
            ``down`` halves it after the second (mean of four); the shortcut does the same.
    """

    def __init__(self, width_in: int, width: int, resampling: Resampling = "same") -> None:
        super().__init__()
        self.resampling = resampling
        self.norm1, self.norm2 = nn.BatchNorm2d(width_in), nn.BatchNorm2d(width)
        self.conv1 = nn.Conv2d(width_in, width, 3, padding=1)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)
        self.shortcut = nn.Identity() if width_in == width else nn.Conv2d(width_in, width, 1)

    def forward(self, features: Tensor) -> Tensor:
        """(B, width_in, H, W) to (B, width, H', W')."""
        residual = self.conv1(self._grown(functional.relu(self.norm1(features))))
        residual = self._shrunk(self.conv2(functional.relu(self.norm2(residual))))
        shortcut: Tensor = self._shrunk(self._grown(self.shortcut(features)))
        return shortcut + residual

    def _grown(self, features: Tensor) -> Tensor:
        return (
            functional.interpolate(features, scale_factor=2, mode="nearest")
            if self.resampling == "up"
            else features
        )

    def _shrunk(self, features: Tensor) -> Tensor:
        return functional.avg_pool2d(features, 2) if self.resampling == "down" else features


class DepthCompletion(nn.Module):
    """Inverse depth everywhere from an image and the inverse depth that is known.

    Reading:
        Every convolution except the last has spectral normalisation. Widths double from 32 to 256
        and stay there; each level downwards is a 4x4 convolution of stride 2, each level upwards
        doubles bilinearly and convolves 3x3 next to what was seen at that size on the way down. The
        answer replaces known depth, too.
    """

    def __init__(self) -> None:
        super().__init__()
        widths = [4, *(min(WIDTH * 2**level, WIDEST) for level in range(HALVINGS))]
        self.down = nn.ModuleList(
            spectral_norm(nn.Conv2d(before, after, 4, stride=2, padding=1))
            for before, after in pairwise(widths)
        )
        self.up = nn.ModuleList(
            spectral_norm(nn.Conv2d(coarse + fine, fine if level else WIDTH, 3, padding=1))
            for level, (fine, coarse) in enumerate(pairwise(widths))
        )
        self.last = nn.Conv2d(WIDTH, 1, 3, padding=1)

    def forward(self, images: Tensor, inverse_depth: Tensor) -> Tensor:
        """Return the complete some views.

        Args:
            images: (B, 3, H, W) in [-1, 1].
            inverse_depth: as a share of the largest one, (B, 1, H, W), in [0, 1], 0 = unknown.

        Returns:
            Inverse depth as such a share, (B, 1, H, W), above 0 and at most 1.
        """
        height, width = images.shape[2:]
        margins = (0, -width % COMPLETED_MULTIPLE, 0, -height % COMPLETED_MULTIPLE)
        skips = [functional.pad(torch.cat([images, inverse_depth], dim=1), margins)]
        for convolution in self.down:
            skips.append(functional.leaky_relu(convolution(skips[-1]), 0.2))
        features = skips.pop()
        for convolution, before in zip(reversed(self.up), reversed(skips), strict=True):
            grown = functional.interpolate(
                features, scale_factor=2, mode="bilinear", align_corners=False
            )
            features = functional.relu(convolution(torch.cat([grown, before], dim=1)))
        share = torch.sigmoid(self.last(features))[:, :, :height, :width]
        return share.clamp(min=SMALLEST_SHARE)


class ViewFusion(nn.Module):
    """Multi-head attention over views, pixel by pixel; any number of views, in any order.

    Reading:
        The token is added to what the heads give, then a layer normalisation follows. A view
        without a point at a pixel is left out there.
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
