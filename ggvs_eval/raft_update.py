"""The recurrent part of RAFT-Stereo: correlation and flow go in, a step of flow and weights for
upsampling come out.

Names of modules are those of the published checkpoints, of RAFT-Stereo and of GPS-Gaussian; 08, 16
and 32 count as if the finest level lay at an eighth of the image.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.raft_config import CORR_LEVELS, CORR_RADIUS, RaftShape

# a larger volume is not kept but computed again for every lookup, row by row
VOLUME_BYTES = 512 * 2**20
# the context's share of both gates, (B, 2 C, H, W), and of the candidate, (B, C, H, W)
Context = tuple[Tensor, Tensor]


def at_least_single(tensor: Tensor) -> Tensor:
    """Return the tensor in single precision where it had less.

    Positions need it although features do not.
    """
    return tensor.to(torch.promote_types(tensor.dtype, torch.float32))


class Correlation:
    """Correlation of two feature maps, averaged over 1, 2, 4, ... cells of the right row.

    Averaging correlations equals correlating with averaged features, so that the levels need not be
    kept: where the volume would be larger than `volume_bytes`, each lookup computes it again for as
    many rows at a time as fit.

    Args:
        left: (B, C, H, W).
        right: (B, C, H, W).
    """

    def __init__(
        self,
        left: Tensor,
        right: Tensor,
        levels: int,
        radius: int,
        volume_bytes: int = VOLUME_BYTES,
    ) -> None:
        self.radius = radius
        self._left = left.permute(0, 2, 3, 1)  # (B, H, W, C)
        pyramid = [right]
        for _ in range(1, levels):
            pyramid.append(functional.avg_pool2d(pyramid[-1], (1, 2), (1, 2)))
        self._right = [level.permute(0, 2, 1, 3) for level in pyramid]  # (B, H, C, W_l) each
        batch, height, width, _ = self._left.shape
        row_bytes = (
            batch * width * sum(level.shape[-1] + 2 * self._margin for level in self._right) * 4
        )
        self._rows = max(1, volume_bytes // row_bytes)
        self._volume = self._rows_of_volume(0, height) if self._rows >= height else None

    def lookup(self, columns: Tensor) -> Tensor:
        """Return the correlations around given columns of the right image.

        Args:
            columns: assumed position of each left cell in the right image, in cells, (B, H, W).

        Returns:
            (B, levels * (2 * radius + 1), H, W), linear between cells, 0 outside the image.
        """
        height = columns.shape[1]
        if self._volume is not None:
            return self._sample(self._volume, columns)
        bands = [slice(row, min(row + self._rows, height)) for row in range(0, height, self._rows)]
        looked_up = [
            self._sample(self._rows_of_volume(band.start, band.stop), columns[:, band])
            for band in bands
        ]
        return torch.cat(looked_up, dim=2)

    @property
    def _margin(self) -> int:
        """Zeros on either side of a row, so that a lookup outside the image finds them."""
        return 2 * self.radius + 2

    def _rows_of_volume(self, start: int, stop: int) -> list[Tensor]:
        """Return the correlations of some rows at all levels, (B, rows, W, W_l + 2 margins) each,
        float32.
        """
        scale = self._left.shape[-1] ** -0.5
        volume = []
        for right in self._right:
            products = (
                at_least_single(torch.matmul(self._left[:, start:stop], right[:, start:stop]))
                * scale
            )
            volume.append(functional.pad(products, (self._margin, self._margin)))
        return volume

    def _sample(self, volume: list[Tensor], columns: Tensor) -> Tensor:
        """Return the linear interpolation at 2 * radius + 1 columns per cell and level."""
        # one more than is returned
        offsets = torch.arange(-self.radius, self.radius + 2, device=columns.device)
        sampled = []
        for level, products in enumerate(volume):
            centre = columns / 2**level
            below = torch.floor(centre)
            share = (centre - below)[..., None]  # (B, H, W, 1)
            index = below.clamp(
                self.radius - self._margin, products.shape[-1] - self._margin - self.radius - 2
            ).long()
            index = (index + self._margin)[..., None] + offsets  # (B, H, W, 2 * radius + 2)
            cells = torch.gather(products, -1, index)
            sampled.append(torch.lerp(cells[..., :-1], cells[..., 1:], share))
        return torch.cat(sampled, dim=-1).permute(0, 3, 1, 2)


class ConvGru(nn.Module):
    """Gated recurrent unit of 3x3 convolutions.

    The context's share of each gate is computed once, outside.
    """

    def __init__(self, hidden: int, width_in: int) -> None:
        super().__init__()
        self.convz = nn.Conv2d(hidden + width_in, hidden, 3, padding=1)
        self.convr = nn.Conv2d(hidden + width_in, hidden, 3, padding=1)
        self.convq = nn.Conv2d(hidden + width_in, hidden, 3, padding=1)

    def forward(self, hidden: Tensor, context: Context, *inputs: Tensor) -> Tensor:
        """Return one step: h' = (1 - z) h + z q, all (B, C, H, W)."""
        for_gates, for_candidate = context
        features = torch.cat(inputs, dim=1)
        # one wide convolution is faster than two
        weight = torch.cat([self.convz.weight, self.convr.weight])
        bias = torch.cat([gate.bias for gate in (self.convz, self.convr) if gate.bias is not None])
        gates = functional.conv2d(torch.cat([hidden, features], dim=1), weight, bias, padding=1)
        update, reset = torch.sigmoid(gates + for_gates).chunk(2, dim=1)
        candidate = torch.tanh(
            self.convq(torch.cat([reset * hidden, features], dim=1)) + for_candidate
        )
        return torch.lerp(hidden, candidate, update)


class MotionEncoder(nn.Module):
    """Mixes correlations with the flow they were looked up at."""

    def __init__(self, config: RaftShape) -> None:
        super().__init__()
        looked_up = CORR_LEVELS * (2 * CORR_RADIUS + 1)
        width = config.motion_width
        self.convc1 = nn.Conv2d(looked_up, width, 1)
        self.convc2 = nn.Conv2d(width, width, 3, padding=1)
        self.convf1 = nn.Conv2d(2, width, 7, padding=3)
        self.convf2 = nn.Conv2d(width, width, 3, padding=1)
        self.width_out = config.motion_features or config.hidden_width
        self.conv = nn.Conv2d(2 * width, self.width_out - 2, 3, padding=1)

    def forward(self, flow: Tensor, correlation: Tensor) -> Tensor:
        """Return the flow (B, 2, H, W) and correlations to (B, width_out, H, W)."""
        matched = functional.relu(self.convc2(functional.relu(self.convc1(correlation))))
        moved = functional.relu(self.convf2(functional.relu(self.convf1(flow))))
        mixed = functional.relu(self.conv(torch.cat([matched, moved], dim=1)))
        return torch.cat([mixed, flow.to(mixed.dtype)], dim=1)


class FlowHead(nn.Module):
    """The step of the flow, from the finest hidden state."""

    def __init__(self, width_in: int, width: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width_in, width, 3, padding=1)
        self.conv2 = nn.Conv2d(width, 2, 3, padding=1)

    def forward(self, hidden: Tensor) -> Tensor:
        """(B, C, H, W) to (B, 2, H, W)."""
        step: Tensor = self.conv2(functional.relu(self.conv1(hidden)))
        return step


class UpdateBlock(nn.Module):
    """One iteration over all levels, coarse to fine."""

    def __init__(self, config: RaftShape) -> None:
        super().__init__()
        hidden, levels = config.hidden_width, config.n_gru_layers
        self.config = config
        self.n_levels = levels
        self.encoder = MotionEncoder(config)
        self.gru08 = ConvGru(hidden, self.encoder.width_out + hidden * (levels > 1))
        self.gru16 = ConvGru(hidden, hidden + hidden * (levels > 2))
        self.gru32 = ConvGru(hidden, hidden)
        self.flow_head = FlowHead(hidden, config.head_width)
        self.mask = nn.Sequential(
            nn.Conv2d(hidden, config.head_width, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(config.head_width, 9 * config.factor**2, 1),
        )

    def coarse(self, hidden: list[Tensor], context: list[Context], finest: int = 1) -> list[Tensor]:
        """Update the levels from the coarsest down to `finest` (1 = all except the finest one)."""
        hidden = list(hidden)
        if self.n_levels > 2:
            hidden[2] = self.gru32(hidden[2], context[2], _halve(hidden[1]))
        if self.n_levels > 1 and finest <= 1:
            above = [_resize(hidden[2], hidden[1])] if self.n_levels > 2 else []
            hidden[1] = self.gru16(hidden[1], context[1], _halve(hidden[0]), *above)
        return hidden

    def fine(
        self, hidden: list[Tensor], context: list[Context], correlation: Tensor, flow: Tensor
    ) -> list[Tensor]:
        """Update the finest level from what is seen at the present flow."""
        above = [_resize(hidden[1], hidden[0])] if self.n_levels > 1 else []
        return [
            self.gru08(hidden[0], context[0], self.encoder(flow, correlation), *above),
            *hidden[1:],
        ]

    def upsampling_weights(self, hidden: Tensor) -> Tensor:
        """Return the weights of convex upsampling before their softmax, (B, 9 * factor**2,
        H, W).
        """
        weights: Tensor = 0.25 * self.mask(hidden)
        return weights


def walk(
    block: UpdateBlock,
    gates: nn.ModuleList,
    of_left: Tensor,
    of_right: Tensor,
    states: list[tuple[Tensor, Tensor]],
    iterations: int,
    initial: Tensor | None = None,
    volume_bytes: int = VOLUME_BYTES,
) -> tuple[list[Tensor], Tensor]:
    """Return all iterations of one pair or several.

    Args:
        gates: of each level, the convolution that makes the context's share of its gates.
        of_left: features that are correlated, (B, C, H, W).
        of_right: (B, C, H, W).
        states: (hidden, context) of every level, finest first.
        iterations: number of updates, at least 1.
        initial: flow to start from, in cells, (B, 1, H, W); zero by default.
        volume_bytes: memory for the correlation volume, see `Correlation`.

    Returns:
        Flow in cells after each iteration, (B, 1, H, W) each, and the weights that enlarge the last
        one to full size, see `upsample_convex`.

    Reading:
        `slow_fast_gru` with three levels first updates the coarsest alone, then the two coarse
        ones, then all; with two levels, the coarse one, then both.
    """
    correlation = Correlation(
        left=of_left,
        right=of_right,
        levels=CORR_LEVELS,
        radius=CORR_RADIUS,
        volume_bytes=volume_bytes,
    )
    hidden = [state for state, _ in states]
    context = [_split(conv(features)) for conv, (_, features) in zip(gates, states, strict=True)]
    batch, _, height, width = of_left.shape
    dtype = torch.promote_types(of_left.dtype, torch.float32)
    columns = torch.arange(width, device=of_left.device, dtype=dtype).expand(
        batch, 1, height, width
    )
    flow = torch.zeros_like(columns) if initial is None else initial.to(dtype)
    flows = []
    for _ in range(iterations):
        flow = flow.detach()
        hidden = _update(block, hidden, context, correlation.lookup((columns + flow)[:, 0]), flow)
        flow = flow + at_least_single(block.flow_head(hidden[0])[:, :1])
        flows.append(flow)
    return flows, block.upsampling_weights(hidden[0])


def _update(
    block: UpdateBlock,
    hidden: list[Tensor],
    context: list[Context],
    correlation: Tensor,
    flow: Tensor,
) -> list[Tensor]:
    if block.config.slow_fast_gru and block.n_levels > 2:
        hidden = block.coarse(hidden, context, finest=2)
    if block.config.slow_fast_gru and block.n_levels > 1:
        hidden = block.coarse(hidden, context)
    # rectified: nothing moves across rows
    two_channels = torch.cat([flow, torch.zeros_like(flow)], dim=1)
    return block.fine(block.coarse(hidden, context), context, correlation, two_channels)


def _split(context: Tensor) -> Context:
    width = context.shape[1] // 3
    return context[:, : 2 * width], context[:, 2 * width :]


def upsample_convex(flow: Tensor, weights: Tensor, factor: int) -> Tensor:
    """Return each fine pixel is a convex mixture of the 3x3 coarse cells around it.

    Args:
        flow: in cells, (B, 1, H, W).
        weights: before their softmax over the nine cells, (B, 9 * factor**2, H, W).
        factor: fine pixels per cell along each axis.

    Returns:
        Flow in fine pixels, (B, 1, factor * H, factor * W).
    """
    batch, _, height, width = flow.shape
    shares = torch.softmax(
        at_least_single(weights).view(batch, 9, factor, factor, height, width), dim=1
    )
    cells = functional.unfold(factor * flow, 3, padding=1).view(batch, 9, 1, 1, height, width)
    mixed = (shares * cells).sum(dim=1)  # (B, factor, factor, H, W)
    return mixed.permute(0, 3, 1, 4, 2).reshape(batch, 1, factor * height, factor * width)


def _halve(features: Tensor) -> Tensor:
    return functional.avg_pool2d(features, 3, stride=2, padding=1)


def _resize(features: Tensor, like: Tensor) -> Tensor:
    return functional.interpolate(features, like.shape[2:], mode="bilinear", align_corners=True)
