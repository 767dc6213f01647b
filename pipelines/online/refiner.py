"""The last layers of the blending network: filters of every pixel's own, which soften edges and
sharpen what blending blurred.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

REACH_PX = 2
# row, column
TAPS = (
    (-2, 0),
    (-1, -1),
    (-1, 0),
    (-1, 1),
    (0, -2),
    (0, -1),
    (0, 1),
    (0, 2),
    (1, -1),
    (1, 0),
    (1, 1),
    (2, 0),
)
EVIDENCE = 6  # channels of `evidence`
STATISTICS = 4  # of `picture_statistics`
ROW_STEP_PX = 8  # one row in N represents the picture
STATISTICS_GAIN = 4.0
STATISTICS_GRID = 1024.0  # steps per unit that statistics are rounded to
TYPICAL = (-2.9, -2.3, -4.3, -3.7)  # statistics of a validation room
LEAST = 0.002  # half a level of 8 bits: nothing is smaller than that
COLOUR_GAIN = 10.0  # a spread of a tenth of full scale is as much as can be
CONTRAST_GAIN = 4.0
DEPTH_GAIN = 20.0  # a step of a twentieth of the depth is an edge
NO_WEIGHT = 1e-30  # a sum of weights below this is none
ENOUGH_VIEWS = 3.0  # views that can outvote one


class Refiner(nn.Module):
    """Two convolutions at full size that look at evidence and at features of the U-Net, and choose
    each pixel's filter.

    The filter adds differences to a pixel's neighbours, the same for all colours: it cannot invent
    what is not near. How strongly noise, blur and misfit want to be smoothed depends on the
    capture: statistics of the whole picture shift what the convolutions find and scale what the
    filters are made of (feature-wise linear modulation, Perez et al. 2018).

    Args:
        features: channels that the U-Net hands over.
        width: channels in between.

    Reading:
        Not in the paper. Blended views are a mean of sampled colours: silhouettes are as hard as
        the fused depth has them, and views that are a fraction of a pixel apart blur their mean. On
        validation rooms (demo seeds 101-103, nine views) this raises geometric weights alone from
        30.68 to 31.17 dB, linear filters fitted per class of edge and spread to 30.97 dB. Filters
        are predicted instead of colours (Bako et al., Kernel-predicting convolutional networks,
        2017), which learns faster and from fewer rooms: colours went below 30.68 dB in as many
        steps.
    """

    def __init__(self, features: int, width: int = 16) -> None:
        super().__init__()
        widths = (EVIDENCE + features, width, width)
        self.looks = nn.ModuleList(
            nn.Conv2d(before, after, 3, padding=1, padding_mode="replicate")
            for before, after in pairwise(widths)
        )
        self.taps = nn.Conv2d(width, len(TAPS), 1)
        self.condition = nn.Linear(STATISTICS, 3 * width)  # two shifts and a gain per channel
        for parameter in (*self.taps.parameters(), *self.condition.parameters()):
            nn.init.zeros_(parameter)  # so an untrained network changes nothing

    def forward(self, picture: Tensor, evidence: Tensor, features: Tensor) -> Tensor:
        """Blended picture (B, 3, H, W), `evidence` and features (B, F, H, W) to the refined
        picture, float32.
        """
        statistics = picture_statistics(picture, evidence[:, 0]).to(self.condition.weight.dtype)
        *shifts, gain = self.condition(statistics)[..., None, None].chunk(3, dim=1)
        values = torch.cat([evidence, features], dim=1)
        for look, shift in zip(self.looks, shifts, strict=True):
            values = functional.leaky_relu(look(values) + shift, 0.1)
        return filtered(picture, self.taps(values * (1 + gain)).float())


def picture_statistics(picture: Tensor, spread: Tensor) -> Tensor:
    """Summarise how well a picture's views agree and how much fine detail it has.

    No gradient passes.

    Args:
        picture: blended views, (B, 3, H, W), in [0, 1].
        spread: the first channel of `evidence`, (B, H, W).

    Returns:
        (B, 4), float64: logarithms of the spread's geometric and arithmetic mean, then those of the
        mean colour's absolute second differences (0 in a picture that has none), of every eighth
        row; less typical values and scaled. Multiples of 2^-10: neither the order of a sum nor the
        processor's logarithm changes a bit.
    """
    with torch.no_grad():
        parts = slice(1, -1, ROW_STEP_PX), slice(0, -2, ROW_STEP_PX), slice(2, None, ROW_STEP_PX)
        rows, above, below = (picture[:, :, part].mean(dim=1) for part in parts)
        along_columns = (rows - (above + below) / 2).abs()[..., 1:-1]
        detail = along_columns + (rows[..., 1:-1] - (rows[..., :-2] + rows[..., 2:]) / 2).abs()
        means = []
        for values in (
            spread[:, ::ROW_STEP_PX],
            detail if detail.numel() else torch.zeros_like(spread[:, :1, :1]),
        ):
            flat = values.double().flatten(1)
            means += [(flat + LEAST).log().mean(dim=1), (flat.mean(dim=1) + LEAST).log()]
        scaled = STATISTICS_GAIN * torch.stack(
            [mean - usual for mean, usual in zip(means, TYPICAL, strict=True)], dim=1
        )
        return (scaled * STATISTICS_GRID).round() / STATISTICS_GRID


def filtered(picture: Tensor, taps: Tensor) -> Tensor:
    """Return a picture plus its differences to neighbours, weighted by filters that change from
    pixel to pixel.

    Args:
        picture: (B, 3, H, W).
        taps: weight of each neighbour in `TAPS`, (B, 12, H, W).
    """
    height, width = picture.shape[2:]
    around = functional.pad(picture, (REACH_PX,) * 4, mode="replicate")
    total = picture * (1 - taps.sum(dim=1, keepdim=True))
    for tap, (down, right) in enumerate(TAPS):
        rows, columns = (
            slice(REACH_PX + down, REACH_PX + down + height),
            slice(REACH_PX + right, REACH_PX + right + width),
        )
        total = total + taps[:, tap, None] * around[..., rows, columns]
    return total


def evidence(
    picture: Tensor, colours: Tensor, weights: Tensor, visibilities: Tensor, depth: Tensor
) -> Tensor:
    """Compute the channels that measure the certainty of the blended picture.

    No gradient passes through them.

    Args:
        picture: weighted mean of the views, (B, 3, H, W).
        colours: the views, (B, K, 3, H, W).
        weights: what they were blended by, (B, K, H, W).
        visibilities: how far each view shows the pixel, (B, K, H, W), in [0, 1].
        depth: fused depth, (B, H, W), 0 where unknown or not to be used.

    Returns:
        (B, 6, H, W), all within [-1, 1]: standard deviation of the views, how many show the pixel,
        relief of the depth, its range within 3 x 3 and within 5 x 5 pixels, and contrast within 3 x
        3 pixels.
    """
    with torch.no_grad():
        difference = (colours - picture[:, None]).square().mean(dim=2)  # (B, K, H, W)
        spread = (
            (weights * difference).sum(dim=1) / weights.sum(dim=1).clamp_min(NO_WEIGHT)
        ).sqrt()
        mask = depth > 0
        logarithm = torch.where(mask, depth, torch.ones_like(depth)).log()
        channels = [
            COLOUR_GAIN * spread,
            visibilities.sum(dim=1) / ENOUGH_VIEWS,
            DEPTH_GAIN * relief(logarithm, mask),
            DEPTH_GAIN * local_range(logarithm, 3),
            DEPTH_GAIN / 2 * local_range(logarithm, 5),
            CONTRAST_GAIN * local_range(picture.mean(dim=1), 3),
        ]
        return torch.stack(channels, dim=1).clamp(-1, 1)


def relief(logarithm: Tensor, has_depth: Tensor) -> Tensor:
    """Return the logarithm of depth less its mean over what is known within 5 x 5 pixels, (B, H,
    W), 0 where unknown.
    """
    maps = torch.stack([logarithm * has_depth, has_depth.float()], dim=1)
    means = functional.avg_pool2d(maps, 5, 1, 2)
    return (logarithm - means[:, 0] / means[:, 1].clamp(min=1e-6)) * has_depth


def local_range(values: Tensor, size_px: int) -> Tensor:
    """Return the largest less smallest value within a square window, (B, H, W)."""
    bounds = torch.stack([values, -values], dim=1)
    return functional.max_pool2d(bounds, size_px, 1, size_px // 2).sum(dim=1)
