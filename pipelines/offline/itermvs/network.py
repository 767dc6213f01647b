"""IterMVS (Wang, Galliani, Vogel, Pollefeys: Iterative Probability Estimation for Efficient
Multi-View Stereo, CVPR 2022).

A recurrent state per pixel encodes the distribution of its inverse depth. Each iteration correlates
the camera's features with the partners' at a few depths around the present one, at three sizes, and
updates the state by what it finds. Names of modules are those of the published checkpoints.

K cameras are one batch: B is K, or K N where the N hypotheses of a pixel are computed as separate
images. A forward pass allocates and launches the same regardless of the values, and never waits for
the device: it can be recorded in a CUDA graph.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

SIZE_MULTIPLE = 32  # both sides of every image
WIDTHS = (8, 16, 32, 48)  # channels at the full size, its half, quarter and eighth
GROUPS = 8  # of channels, correlated each alone
HIDDEN_WIDTH = 32
FIRST_DEPTHS = 32  # hypotheses of the initialisation, at an eighth of the size
# of the distribution over inverse depth; its mean is taken around its mode
BINS, BIN_RADIUS = 256, 4
# hypotheses around the present depth, bins, per level
OFFSETS = ((-2, -2 / 3, 2 / 3, 2), (-8, -8 / 3, 8 / 3, 8), (-32, 32))
# of the near depth: what is nearer to a partner, or behind it, is invisible to it
NEAREST_SHARE = 1e-2

Features = Sequence[Tensor]  # (B, C, H / s, W / s) at s = 2, 4, 8


@dataclass(frozen=True, eq=False)
class MatchedViews:
    """K cameras, M partners each, and their depth ranges, as tensors on the device.

    Attributes:
        members: index of the picture of each camera, then of its partners, (K, 1 + M), int64.
        projections: (K, M, 13). 9 numbers of a matrix that takes a pixel of the camera (u, v, 1),
            times its depth, to the partner's homogeneous pixels, 3 of an offset that is added, and
            1, or 0 if there is no such partner. Pixels are whole: the middle of the first one is at
            0.
        ranges: inverse depth at far, its growth from there to near, and the least depth at which a
            partner sees, (K, 3).
    """

    members: Tensor
    projections: Tensor
    ranges: Tensor


@dataclass(frozen=True, eq=False)
class Partner:
    """One partner of each camera: features (K, C, H / s, W / s), rows of
    `MatchedViews.projections`, (K, 13).
    """

    features: Features
    projection: Tensor

    @property
    def counted(self) -> Tensor:
        """1, or 0 if there is no such partner, (K, 1, 1, 1)."""
        return self.projection[:, 12].view(-1, 1, 1, 1)

    def rays(self, size: Sequence[int], spacing: int) -> Tensor:
        """Homogeneous pixels at depth 1, without the offset, of one pixel of the camera every
        `spacing`, (K, 3, *size).
        """
        v, u = (
            torch.arange(side, device=self.projection.device, dtype=torch.float32) * spacing
            for side in size
        )
        matrix = self.projection[:, :9].view(-1, 3, 3, 1, 1)
        return matrix[:, :, 0] * u + matrix[:, :, 1] * v[:, None] + matrix[:, :, 2]


class Convolution(nn.Module):
    """A 3x3 convolution, a normalisation if there is one, and a ReLU where it is wanted."""

    def __init__(
        self,
        width_in: int,
        width: int,
        stride: int = 1,
        *,
        normalised: bool = False,
        relu: bool = True,
    ) -> None:
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
    """Two normalised convolutions with a shortcut, which is strided where they are."""

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
        self.layer1, self.layer2, self.layer3 = (
            _stage(full, half),
            _stage(half, quarter),
            _stage(quarter, eighth),
        )
        self.output1, self.output2, self.output3 = (
            nn.Conv2d(eighth, width, 3, padding=1) for width in WIDTHS[1:]
        )
        self.inner1, self.inner2 = nn.Conv2d(half, eighth, 1), nn.Conv2d(quarter, eighth, 1)
        self.inner3 = nn.Conv2d(eighth, eighth, 1)  # is in the checkpoints, and is never used

    def forward(self, image: Tensor) -> Features:
        """Return the features at half, a quarter and an eighth of the size, float32.

        `image` is (B, 3, H, W), RGB in [-1, 1].
        """
        half = self.layer1(self.conv1(image))
        quarter = self.layer2(half)
        eighth = self.layer3(quarter)
        of_quarter = _enlarged(eighth) + self.inner2(quarter)
        of_half = _enlarged(of_quarter) + self.inner1(half)
        outputs = self.output1(of_half), self.output2(of_quarter), self.output3(eighth)
        return [output.float().contiguous() for output in outputs]


class ViewWeight(nn.Module):
    """Trust in a partner at each pixel: the peak of its softmax over the hypotheses."""

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Sequential(Convolution(GROUPS, 16), nn.Conv2d(16, 1, 1))

    def forward(self, correlation: Tensor) -> Tensor:
        """(K, N, G, H, W) to (K, 1, H, W)."""
        score: Tensor = (
            self.conv(correlation.flatten(0, 1)).float().reshape(correlation[:, :, 0].shape)
        )
        return score.softmax(dim=1).amax(dim=1, keepdim=True)


class CorrelationNetwork(nn.Module):
    """A small U-Net over each hypothesis alone."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = Convolution(GROUPS, 8)
        self.conv1 = Convolution(8, 16, 2)
        self.conv2 = Convolution(16, 32, 2)
        self.conv3 = nn.ConvTranspose2d(32, 16, 3, 2, padding=1, output_padding=1, bias=False)
        self.conv4 = nn.ConvTranspose2d(16, 8, 3, 2, padding=1, output_padding=1, bias=False)
        self.conv5 = nn.Conv2d(8, 1, 3, padding=1)

    def forward(self, correlation: Tensor) -> Tensor:
        """(K, N, G, H, W), sides multiples of 4, to the score of each hypothesis, (K, N, H, W)."""
        full = self.conv0(correlation.flatten(0, 1))
        half = self.conv1(full)
        half = half + self.conv3(self.conv2(half))
        score: Tensor = self.conv5(full + self.conv4(half))
        return score.float().reshape(correlation[:, :, 0].shape)


class Evaluation(nn.Module):
    """Scores of depth hypotheses by the partners' features."""

    def __init__(self) -> None:
        super().__init__()
        self.pixel_view_weight = ViewWeight()
        self.corr_conv1 = nn.ModuleList(CorrelationNetwork() for _ in OFFSETS)

    def first(
        self, reference: Features, partners: Sequence[Partner], depths: Tensor, nearest: Tensor
    ) -> tuple[Tensor, list[Tensor]]:
        """Return the scores at an eighth of the size, and how far to trust each partner, at a
        quarter.

        Args:
            partners: at least one.
            depths: hypotheses, (K, N, H / 8, W / 8).
            nearest: see `MatchedViews.ranges`, (K, 1, 1, 1).

        Returns:
            (K, N, H / 8, W / 8), and of each partner (K, 1, H / 4, W / 4).
        """
        size = depths.shape[2:]
        correlations = [
            _correlate(reference[2], partner, 2, partner.rays(size, 8), depths, nearest)
            for partner in partners
        ]
        weights = [
            self.pixel_view_weight(c) * partner.counted
            for c, partner in zip(correlations, partners, strict=True)
        ]
        return self.corr_conv1[2](_weighted(correlations, weights)), [
            _enlarged(weight) for weight in weights
        ]

    def around(
        self,
        at_quarter: Features,
        partners: Sequence[tuple[Partner, Tensor]],
        weights: Sequence[Tensor],
        depths: Sequence[Tensor],
        nearest: Tensor,
    ) -> Tensor:
        """Return the scores at a quarter of the size of hypotheses at three levels, (K, N1 + N2 +
        N3, H / 4, W / 4).

        Args:
            at_quarter: features of the cameras of the three levels, all at a quarter of the size.
            partners: at least one, with their rays at that size.
            depths: of each level, (K, N, H / 4, W / 4).
        """
        scores = []
        for level, (reference, hypotheses) in enumerate(zip(at_quarter, depths, strict=True)):
            correlations = [
                _correlate(reference, partner, level, rays, hypotheses, nearest)
                for partner, rays in partners
            ]
            scores.append(self.corr_conv1[level](_weighted(correlations, weights)))
        return torch.cat(scores, dim=1)


class RecurrentUnit(nn.Module):
    """A convolutional gated recurrent unit with dilated kernels."""

    def __init__(self, width_in: int) -> None:
        super().__init__()
        gates = (
            nn.Conv2d(HIDDEN_WIDTH + width_in, HIDDEN_WIDTH, 3, padding=2, dilation=2)
            for _ in range(3)
        )
        self.convz, self.convr, self.convq = gates

    def forward(self, hidden: Tensor, features: Tensor) -> Tensor:
        """Return the next state, as large as the one before."""
        inputs = torch.cat([hidden, features], dim=1)
        update, reset = (
            torch.sigmoid(self.convz(inputs).float()),
            torch.sigmoid(self.convr(inputs).float()),
        )
        proposed = torch.tanh(self.convq(torch.cat([reset * hidden, features], dim=1)).float())
        return (1 - update) * hidden + update * proposed


class Update(nn.Module):
    """The recurrent state, and its depth and confidence."""

    def __init__(self) -> None:
        super().__init__()
        self.gru = RecurrentUnit(1 + sum(map(len, OFFSETS)))
        self.depth_head = nn.Sequential(
            _dilated(),
            nn.ReLU(),
            nn.Conv2d(32, 64, 1, bias=False),
            nn.ReLU(),
            nn.Conv2d(64, BINS, 1),
        )
        self.confidence_head = nn.Sequential(_dilated(), nn.ReLU(), nn.Conv2d(32, 1, 1))
        self.hidden_init_head = nn.Sequential(
            nn.Conv2d(FIRST_DEPTHS, 64, 3, padding=1, bias=False),
            nn.ReLU(),
            nn.Conv2d(64, HIDDEN_WIDTH, 1),
        )

    def begin(self, scores: Tensor) -> Tensor:
        """Return the first state, at twice the size of the scores."""
        return torch.tanh(_enlarged(self.hidden_init_head(scores).float()))

    def place(self, hidden: Tensor) -> Tensor:
        """Inverse depth as a share of the range from far to near, (K, 1, H, W): the mean of the
        distribution around its mode.
        """
        probability = self.depth_head(hidden).float().softmax(dim=1)
        window = torch.arange(-BIN_RADIUS, BIN_RADIUS + 1, device=hidden.device).view(1, -1, 1, 1)
        bins = (probability.argmax(dim=1, keepdim=True) + window).clamp(0, BINS - 1)
        shares = probability.gather(1, bins)
        mean: Tensor = (bins * shares).sum(dim=1, keepdim=True) / (
            shares.sum(dim=1, keepdim=True) + 1e-6
        )
        return mean / (BINS - 1)

    def confidence(self, hidden: Tensor) -> Tensor:
        """In [0, 1], (K, 1, H, W)."""
        return torch.sigmoid(self.confidence_head(hidden).float())


class Estimator(nn.Module):
    """The iterations, from features to depth."""

    offsets: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.evaluation = Evaluation()
        self.update = Update()
        self.upsample = nn.Sequential(
            nn.Conv2d(WIDTHS[2], 64, 3, padding=1, bias=False),
            nn.ReLU(),
            nn.Conv2d(64, 9 * 16, 1, bias=False),
        )
        offsets = torch.tensor([share / BINS for level in OFFSETS for share in level]).view(
            1, -1, 1, 1
        )
        # the checkpoints do not have them
        self.register_buffer("offsets", offsets, persistent=False)

    def forward(
        self, slots: Sequence[Features], views: MatchedViews, iterations: int
    ) -> tuple[Tensor, Tensor]:
        """Return the depth and confidence, (K, H, W).

        Args:
            slots: features of the cameras, then of each partner, of K pictures each.
        """
        reference, *partner_features = slots
        partners = [
            Partner(features, views.projections[:, m])
            for m, features in enumerate(partner_features)
        ]
        inverse_far, growth, nearest = (
            column.view(-1, 1, 1, 1) for column in views.ranges.unbind(1)
        )

        def depth_at(place: Tensor) -> Tensor:
            return 1 / (inverse_far + place * growth)

        half, quarter, eighth = reference
        first = torch.linspace(0, 1, FIRST_DEPTHS, device=half.device).view(1, -1, 1, 1)
        first = first.expand(len(half), -1, *eighth.shape[2:])
        scores, weights = self.evaluation.first(reference, partners, depth_at(first), nearest)
        hidden = self.update.begin(scores)
        place = self.update.place(hidden)
        at_quarter = (
            functional.interpolate(half, scale_factor=0.5, mode="bilinear"),
            quarter,
            _enlarged(eighth),
        )
        with_rays = [(partner, partner.rays(quarter.shape[2:], 4)) for partner in partners]
        for _ in range(iterations):
            depths = depth_at((place + self.offsets).clamp(0, 1)).split(
                [len(offsets) for offsets in OFFSETS], dim=1
            )
            scores = self.evaluation.around(at_quarter, with_rays, weights, depths, nearest)
            hidden = self.update.gru(hidden, torch.cat([place, scores], dim=1))
            place = self.update.place(hidden)
        confidence = functional.interpolate(
            self.update.confidence(hidden), scale_factor=4, mode="bilinear"
        )
        return depth_at(self._full_size(place, quarter))[:, 0], confidence[:, 0]

    def _full_size(self, place: Tensor, features: Tensor) -> Tensor:
        """Return four times the size: each pixel a convex combination of the nine places
        around it.
        """
        rows, columns = place.shape[2:]
        shares = (
            self.upsample(features)
            .float()
            .contiguous()
            .view(-1, 9, 4, 4, rows, columns)
            .softmax(dim=1)
        )
        around = functional.unfold(functional.pad(place, (1, 1, 1, 1), mode="replicate"), 3).view(
            -1, 9, 1, 1, rows, columns
        )
        # (K, 4, 4, H / 4, W / 4): rows and columns within a place
        fine = (shares * around).sum(dim=1)
        return fine.permute(0, 3, 1, 4, 2).reshape(-1, 1, 4 * rows, 4 * columns)


class IterMvsNetwork(nn.Module):
    """The whole network."""

    def __init__(self) -> None:
        super().__init__()
        self.feature_net = FeatureNetwork()
        self.iter_mvs = Estimator()

    def forward(
        self, pictures: Sequence[Tensor], views: MatchedViews, iterations: int = 4
    ) -> tuple[Tensor, Tensor]:
        """Return the depth of K cameras.

        Args:
            pictures: all of one size in one tensor, which `views.members` index; or, of different
                sizes, one tensor of the cameras' and one of each partner's. (P, H, W, 3), RGB
                uint8, sides multiples of 32. Features of each are computed once.
            views: the cameras and at least one partner of each.
            iterations: of the recurrent unit; the authors take four.

        Returns:
            Depth and confidence in [0, 1] at the cameras' size, (K, H, W).
        """
        features = [
            self.feature_net(picture.permute(0, 3, 1, 2).float() / 127.5 - 1)
            for picture in pictures
        ]
        slots = [
            [level.index_select(0, members) for level in features[slot if len(features) > 1 else 0]]
            for slot, members in enumerate(views.members.unbind(1))
        ]
        depth, confidence = self.iter_mvs(slots, views, iterations)
        return depth, confidence


def _correlate(
    reference: Tensor, partner: Partner, level: int, rays: Tensor, depths: Tensor, nearest: Tensor
) -> Tensor:
    """Correlation of the cameras' features with a partner's at each hypothesis, by groups of
    channels, (K, N, G, H, W).

    Args:
        reference: (K, C, H, W).
        partner: whose features of the `level` are looked up, zero outside of them.
        level: 0, 1, 2: half, quarter, eighth.
        rays: of the points of the reference, (K, 3, H, W), see `Partner.rays`.
        depths: (K, N, H, W).
    """
    features, (count, n, height, width) = partner.features[level], depths.shape
    offset = partner.projection[:, 9:12].view(-1, 3, 1, 1, 1)
    # (K, N, H, W) each
    x, y, z = (rays[:, axis, None] * depths + offset[:, axis] for axis in range(3))
    hidden = z <= nearest
    z = z.masked_fill(hidden, 1.0)
    # half pixels
    extents = [(side - 1) * 2.0**level for side in (features.shape[3], features.shape[2])]
    places = [
        (coordinate / z / extent - 1).masked_fill(hidden, 2.0)
        for coordinate, extent in zip((x, y), extents, strict=True)
    ]
    grid = torch.stack(places, dim=-1).view(count, n * height, width, 2)
    looked_up = functional.grid_sample(features, grid, align_corners=True)
    grouped = looked_up.view(count, GROUPS, -1, n, height, width) * reference.view(
        count, GROUPS, -1, 1, height, width
    )
    return grouped.mean(dim=2).transpose(1, 2)


def _weighted(correlations: Sequence[Tensor], weights: Sequence[Tensor]) -> Tensor:
    """Return the mean over partners, (K, N, G, H, W)."""
    pairs = zip(correlations, weights, strict=True)
    total: Tensor = sum((c * w[:, :, None] for c, w in pairs), torch.zeros_like(correlations[0]))
    return total / (sum(weights, torch.zeros_like(weights[0])) + 1e-5)[:, :, None]


def _stage(width_in: int, width: int) -> nn.Sequential:
    return nn.Sequential(ResidualBlock(width_in, width, 2), ResidualBlock(width, width, 1))


def _enlarged(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2, mode="bilinear")


def _dilated() -> nn.Conv2d:
    return nn.Conv2d(HIDDEN_WIDTH, 32, 3, padding=2, dilation=2, bias=False)
