"""IterMVS (Wang, Galliani, Vogel, Pollefeys: Iterative Probability Estimation for Efficient Multi-View Stereo, CVPR 2022).

A recurrent state per pixel encodes the distribution of its inverse depth. Each iteration correlates the camera's features with
the partners' at a few depths around the present one, at three sizes, and updates the state by what it finds. Names of modules are
those of the published checkpoints.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

SIZE_MULTIPLE = 32  # both sides of every image
WIDTHS = (8, 16, 32, 48)  # channels at the full size, its half, quarter and eighth
GROUPS = 8  # of channels, correlated each by itself
HIDDEN_WIDTH = 32
FIRST_DEPTHS = 32  # hypotheses of the initialisation, at an eighth of the size
BINS, BIN_RADIUS = 256, 4  # of the distribution over inverse depth; its mean is taken around its mode
OFFSETS = ((-2, -2 / 3, 2 / 3, 2), (-8, -8 / 3, 8 / 3, 8), (-32, 32))  # hypotheses around the present depth, bins, per level
NEAREST_SHARE = 1e-2  # of the near depth: what lies nearer to a partner, or behind it, it does not see

Features = Sequence[Tensor]  # (1, C, H / s, W / s) at s = 2, 4, 8
Normalise = Callable[[int], nn.Module]


@dataclass(frozen=True, eq=False)
class Partner:
    """A partner, as the camera's pixels meet it.

    Attributes:
        matrix: (3, 3), a pixel of the camera (u, v, 1), times its depth, to the partner's homogeneous pixels, ...
        offset: ... but for this, (3,). Both count whole pixels: the first one's middle is at 0.
    """

    features: Features
    matrix: Tensor
    offset: Tensor


class Convolution(nn.Module):
    """A 3x3 convolution, a normalisation where there is one, and a ReLU where it is wanted."""

    def __init__(self, width_in: int, width: int, stride: int = 1, *, normalised: bool = False, relu: bool = True) -> None:
        super().__init__()
        self.conv = nn.Conv2d(width_in, width, 3, stride, padding=1, bias=False)
        if normalised:
            self.bn = nn.BatchNorm2d(width)
        self._normalised, self._relu = normalised, relu

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, H / stride, W / stride)."""
        result: Tensor = self.conv(features)
        result = self.bn(result) if self._normalised else result
        return functional.relu(result) if self._relu else result


class ResidualBlock(nn.Module):
    """Two normalised convolutions beside a shortcut, which is strided where they are."""

    def __init__(self, width_in: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = Convolution(width_in, width, stride, normalised=True)
        self.conv2 = Convolution(width, width, normalised=True, relu=False)
        if stride > 1:
            self.downsample = Convolution(width_in, width, stride, normalised=True, relu=False)
        self._strided = stride > 1

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width, H / stride, W / stride)."""
        shortcut = self.downsample(features) if self._strided else features
        return functional.relu(shortcut + self.conv2(self.conv1(features)))


class FeatureNetwork(nn.Module):
    """Three strided stages down, lateral connections back up to half the size."""

    def __init__(self) -> None:
        super().__init__()
        full, half, quarter, eighth = WIDTHS
        self.conv1 = Convolution(3, full, normalised=True)
        self.layer1, self.layer2, self.layer3 = _stage(full, half), _stage(half, quarter), _stage(quarter, eighth)
        self.output1, self.output2, self.output3 = (nn.Conv2d(eighth, width, 3, padding=1) for width in WIDTHS[1:])
        self.inner1, self.inner2 = nn.Conv2d(half, eighth, 1), nn.Conv2d(quarter, eighth, 1)
        self.inner3 = nn.Conv2d(eighth, eighth, 1)  # lies in the checkpoints, and is never used

    def forward(self, image: Tensor) -> Features:
        """Features at half, a quarter and an eighth of the size; `image` is (1, 3, H, W), RGB in [-1, 1]."""
        half = self.layer1(self.conv1(image))
        quarter = self.layer2(half)
        eighth = self.layer3(quarter)
        of_quarter = _enlarged(eighth) + self.inner2(quarter)
        of_half = _enlarged(of_quarter) + self.inner1(half)
        return self.output1(of_half), self.output2(of_quarter), self.output3(eighth)


class ViewWeight(nn.Module):
    """Trust in a partner at each pixel: the peak of its softmax over the hypotheses."""

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Sequential(Convolution(GROUPS, 16), nn.Conv2d(16, 1, 1))

    def forward(self, correlation: Tensor) -> Tensor:
        """(N, G, H, W) to (1, 1, H, W)."""
        score: Tensor = self.conv(correlation)
        return score.softmax(dim=0).amax(dim=0, keepdim=True)


class CorrelationNetwork(nn.Module):
    """A small U-Net over each hypothesis by itself."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = Convolution(GROUPS, 8)
        self.conv1 = Convolution(8, 16, 2)
        self.conv2 = Convolution(16, 32, 2)
        self.conv3 = nn.ConvTranspose2d(32, 16, 3, 2, padding=1, output_padding=1, bias=False)
        self.conv4 = nn.ConvTranspose2d(16, 8, 3, 2, padding=1, output_padding=1, bias=False)
        self.conv5 = nn.Conv2d(8, 1, 3, padding=1)

    def forward(self, correlation: Tensor) -> Tensor:
        """(N, G, H, W), sides multiples of 4, to the score of each hypothesis, (1, N, H, W)."""
        whole = self.conv0(correlation)
        half = self.conv1(whole)
        half = half + self.conv3(self.conv2(half))
        score: Tensor = self.conv5(whole + self.conv4(half))
        return score.transpose(0, 1)


class Evaluation(nn.Module):
    """Scores of depth hypotheses by the partners' features."""

    def __init__(self) -> None:
        super().__init__()
        self.pixel_view_weight = ViewWeight()
        self.corr_conv1 = nn.ModuleList(CorrelationNetwork() for _ in OFFSETS)

    def first(
        self, reference: Features, partners: Sequence[Partner], depths: Tensor, nearest: float
    ) -> tuple[Tensor, list[Tensor]]:
        """Scores at an eighth of the size, and how far to trust each partner, at a quarter.

        Args:
            partners: at least one.
            depths: hypotheses, (N, H / 8, W / 8).

        Returns:
            (1, N, H / 8, W / 8), and of each partner (1, 1, H / 4, W / 4).
        """
        correlations = [_correlate(reference[2], partner, 2, 8, depths, nearest) for partner in partners]
        weights = [self.pixel_view_weight(correlation) for correlation in correlations]
        return self.corr_conv1[2](_weighted(correlations, weights)), [_enlarged(weight) for weight in weights]

    def around(
        self,
        at_quarter: Features,
        partners: Sequence[Partner],
        weights: Sequence[Tensor],
        depths: Sequence[Tensor],
        nearest: float,
    ) -> Tensor:
        """Scores at a quarter of the size of hypotheses at three levels, (1, N1 + N2 + N3, H / 4, W / 4).

        Args:
            at_quarter: features of the camera of the three levels, all at a quarter of the size.
            partners: at least one.
            depths: of each level, (N, H / 4, W / 4).
        """
        scores = []
        for level, (reference, hypotheses) in enumerate(zip(at_quarter, depths, strict=True)):
            correlations = [_correlate(reference, partner, level, 4, hypotheses, nearest) for partner in partners]
            scores.append(self.corr_conv1[level](_weighted(correlations, weights)))
        return torch.cat(scores, dim=1)


class RecurrentUnit(nn.Module):
    """A convolutional gated recurrent unit with dilated kernels."""

    def __init__(self, width_in: int) -> None:
        super().__init__()
        gates = (nn.Conv2d(HIDDEN_WIDTH + width_in, HIDDEN_WIDTH, 3, padding=2, dilation=2) for _ in range(3))
        self.convz, self.convr, self.convq = gates

    def forward(self, hidden: Tensor, features: Tensor) -> Tensor:
        """The next state, as large as the one before."""
        both = torch.cat([hidden, features], dim=1)
        update, reset = torch.sigmoid(self.convz(both)), torch.sigmoid(self.convr(both))
        proposed = torch.tanh(self.convq(torch.cat([reset * hidden, features], dim=1)))
        return (1 - update) * hidden + update * proposed


class Update(nn.Module):
    """The recurrent state, and its depth and confidence."""

    def __init__(self) -> None:
        super().__init__()
        self.gru = RecurrentUnit(1 + sum(map(len, OFFSETS)))
        self.depth_head = nn.Sequential(
            _dilated(), nn.ReLU(), nn.Conv2d(32, 64, 1, bias=False), nn.ReLU(), nn.Conv2d(64, BINS, 1)
        )
        self.confidence_head = nn.Sequential(_dilated(), nn.ReLU(), nn.Conv2d(32, 1, 1))
        self.hidden_init_head = nn.Sequential(
            nn.Conv2d(FIRST_DEPTHS, 64, 3, padding=1, bias=False), nn.ReLU(), nn.Conv2d(64, HIDDEN_WIDTH, 1)
        )

    def begin(self, scores: Tensor) -> Tensor:
        """The first state, at twice the size of the scores."""
        return torch.tanh(_enlarged(self.hidden_init_head(scores)))

    def place(self, hidden: Tensor) -> Tensor:
        """Inverse depth as a share of the range from far to near, (1, 1, H, W): the mean of the distribution around its mode."""
        probability = self.depth_head(hidden).softmax(dim=1)
        window = torch.arange(-BIN_RADIUS, BIN_RADIUS + 1, device=hidden.device).view(1, -1, 1, 1)
        bins = (probability.argmax(dim=1, keepdim=True) + window).clamp(0, BINS - 1)
        shares = probability.gather(1, bins)
        mean: Tensor = (bins * shares).sum(dim=1, keepdim=True) / (shares.sum(dim=1, keepdim=True) + 1e-6)
        return mean / (BINS - 1)

    def confidence(self, hidden: Tensor) -> Tensor:
        """In [0, 1], (1, 1, H, W)."""
        return torch.sigmoid(self.confidence_head(hidden))


class Estimator(nn.Module):
    """The iterations, from features to depth."""

    def __init__(self) -> None:
        super().__init__()
        self.evaluation = Evaluation()
        self.update = Update()
        self.upsample = nn.Sequential(
            nn.Conv2d(WIDTHS[2], 64, 3, padding=1, bias=False), nn.ReLU(), nn.Conv2d(64, 9 * 16, 1, bias=False)
        )

    def forward(
        self, reference: Features, partners: Sequence[Partner], near: float, far: float, iterations: int
    ) -> tuple[Tensor, Tensor]:
        """Depth and confidence, (H, W); see `IterMvsNetwork.forward`."""
        nearest = NEAREST_SHARE * near

        def depth_at(place: Tensor) -> Tensor:
            return 1 / (1 / far + place * (1 / near - 1 / far))

        rows, columns = reference[2].shape[2:]
        first = torch.linspace(0, 1, FIRST_DEPTHS, device=reference[2].device).view(-1, 1, 1).expand(-1, rows, columns)
        scores, weights = self.evaluation.first(reference, partners, depth_at(first), nearest)
        hidden = self.update.begin(scores)
        place = self.update.place(hidden)
        half, quarter, eighth = reference
        at_quarter = functional.interpolate(half, scale_factor=0.5, mode="bilinear"), quarter, _enlarged(eighth)
        offsets = [torch.tensor(each, device=half.device).view(-1, 1, 1) / BINS for each in OFFSETS]
        for _ in range(iterations):
            depths = [depth_at((place[0] + offset).clamp(0, 1)) for offset in offsets]
            scores = self.evaluation.around(at_quarter, partners, weights, depths, nearest)
            hidden = self.update.gru(hidden, torch.cat([place, scores], dim=1))
            place = self.update.place(hidden)
        confidence = functional.interpolate(self.update.confidence(hidden), scale_factor=4, mode="bilinear")
        return depth_at(self._full_size(place, quarter))[0, 0], confidence[0, 0]

    def _full_size(self, place: Tensor, features: Tensor) -> Tensor:
        """Four times the size: each pixel a convex combination of the nine places around it."""
        rows, columns = place.shape[2:]
        shares = self.upsample(features).view(9, 4, 4, rows, columns).softmax(dim=0)
        around = functional.unfold(functional.pad(place, (1, 1, 1, 1), mode="replicate"), 3).view(9, 1, 1, rows, columns)
        fine = (shares * around).sum(dim=0)  # (4, 4, H / 4, W / 4): rows and columns within a place
        return fine.permute(2, 0, 3, 1).reshape(1, 1, 4 * rows, 4 * columns)


class IterMvsNetwork(nn.Module):
    """The whole network."""

    def __init__(self) -> None:
        super().__init__()
        self.feature_net = FeatureNetwork()
        self.iter_mvs = Estimator()

    def forward(
        self,
        images: Sequence[Tensor],
        matrices: Sequence[Tensor],
        offsets: Sequence[Tensor],
        near: float,
        far: float,
        iterations: int = 4,
    ) -> tuple[Tensor, Tensor]:
        """Depth of the first image's camera.

        Args:
            images: of the camera and its partners, (1, 3, H, W) each, RGB in [-1, 1], sides multiples of 32.
            matrices: of each partner, see `Partner`.
            iterations: of the recurrent unit; the authors take four.

        Returns:
            Depth and confidence in [0, 1] at the camera's size, (H, W).
        """
        reference, *others = [self.feature_net(image) for image in images]
        partners = [Partner(*each) for each in zip(others, matrices, offsets, strict=True)]
        depth, confidence = self.iter_mvs(reference, partners, near, far, iterations)
        return depth, confidence


def _correlate(reference: Tensor, partner: Partner, level: int, spacing: int, depths: Tensor, nearest: float) -> Tensor:
    """Correlation of the camera's features with a partner's at each hypothesis, by groups of channels, (N, G, H, W).

    Args:
        reference: (1, C, H, W), one every `spacing` pixels.
        partner: whose features of the `level` are looked up, zero outside of them.
        level: 0, 1, 2: half, quarter, eighth.
        spacing: pixels of the full image from one point to the next.
        depths: (N, H, W).
    """
    features = partner.features[level]
    n, height, width = depths.shape
    v, u = torch.meshgrid(
        *(torch.arange(size, device=depths.device, dtype=torch.float32) * spacing for size in (height, width)), indexing="ij"
    )
    rays = torch.einsum("ij,jhw->ihw", partner.matrix, torch.stack([u, v, torch.ones_like(u)]))
    x, y, z = rays[:, None] * depths + partner.offset.view(3, 1, 1, 1)  # (N, H, W) each
    seen = z > nearest
    extent = torch.tensor([features.shape[3] - 1, features.shape[2] - 1], device=depths.device) * 2.0**level  # half pixels
    grid = torch.stack([x, y], dim=-1) / torch.where(seen, z, torch.ones_like(z))[..., None] / extent - 1
    grid = torch.where(seen[..., None], grid, torch.full_like(grid, 2.0))  # outside
    looked_up = functional.grid_sample(features, grid.view(1, n * height, width, 2), align_corners=True)
    grouped = looked_up.view(GROUPS, -1, n, height, width) * reference.view(GROUPS, -1, 1, height, width)
    return grouped.mean(dim=1).transpose(0, 1)


def _weighted(correlations: Sequence[Tensor], weights: Sequence[Tensor]) -> Tensor:
    """Mean over partners, (N, G, H, W)."""
    total: Tensor = sum((c * w for c, w in zip(correlations, weights, strict=True)), torch.zeros_like(correlations[0]))
    return total / (sum(weights, torch.zeros_like(weights[0])) + 1e-5)


def _stage(width_in: int, width: int) -> nn.Sequential:
    return nn.Sequential(ResidualBlock(width_in, width, 2), ResidualBlock(width, width, 1))


def _enlarged(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2, mode="bilinear")


def _dilated() -> nn.Conv2d:
    return nn.Conv2d(HIDDEN_WIDTH, 32, 3, padding=2, dilation=2, bias=False)
