"""The stereo half: a recurrent unit walks along the rows of both images to the match, as in RAFT-Stereo, with one level.

Names of modules are those of the published checkpoint. It also holds two units of coarser levels that are never run.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.baselines.gps_gaussian.unet import residual_block

HIDDEN, MOTION, FACTOR = 96, 128, 8  # channels of the state and of the motion features; pixels per cell
FLOW_WIDTH, MASK_WIDTH = 256, 256
LEVELS, RADIUS = 4, 4  # averages over 1, 2, 4, 8 cells; 4 cells looked up on either side
MARGIN = 2 * RADIUS + 2  # zeros on either side of a row, so that a lookup outside the image finds them


class Stereo(nn.Module):
    """Flow of both images of a rectified pair, each to the other ('raft_stereo').

    Args:
        width: channels of the features at an eighth of the size.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.cnet = ContextEncoder(width)
        self.context_zqr_convs = nn.ModuleList([nn.Conv2d(HIDDEN, 3 * HIDDEN, 3, padding=1)])
        self.update_module = UpdateModule()

    def forward(self, features: Tensor, iterations: int) -> Tensor:
        """Flow after some iterations.

        Args:
            features: at an eighth of the size, (2, C, H / 8, W / 8): left image, right image.
            iterations: number of updates, at least 1.

        Returns:
            Horizontal flow in pixels, (2, 1, H, W): column of the match in the other image less the own column.
        """
        matched, hidden, context = self.cnet(features)
        gates: Tensor = self.context_zqr_convs[0](torch.relu(context))
        rows = correlation_rows(matched, matched.flip(0))
        flow: Tensor = self.update_module(rows, torch.tanh(hidden), gates, iterations)
        return flow


class ContextEncoder(nn.Module):
    """From the features of an image: what is correlated, where the recurrent state starts, and its context ('cnet')."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv2 = nn.Sequential(residual_block(width, width), nn.Conv2d(width, 2 * width, 3, padding=1))
        self.outputs08 = nn.ModuleList(
            nn.Sequential(residual_block(width, width), nn.Conv2d(width, HIDDEN, 3, padding=1)) for _ in ("hidden", "context")
        )

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, C, H, W) to features (B, 2 C, H, W), and state and context before their activations, (B, HIDDEN, H, W)."""
        hidden, context = (head(features) for head in self.outputs08)
        return self.conv2(features), hidden, context


class ConvGru(nn.Module):
    """Gated recurrent unit of 3x3 convolutions; the context's share of each gate is computed once, outside."""

    def __init__(self, width_in: int) -> None:
        super().__init__()
        self.convz = nn.Conv2d(HIDDEN + width_in, HIDDEN, 3, padding=1)
        self.convr = nn.Conv2d(HIDDEN + width_in, HIDDEN, 3, padding=1)
        self.convq = nn.Conv2d(HIDDEN + width_in, HIDDEN, 3, padding=1)

    def forward(self, hidden: Tensor, context: Tensor, motion: Tensor) -> Tensor:
        """One step: h' = (1 - z) h + z q, (B, HIDDEN, H, W); context is (B, 3 HIDDEN, H, W) for z, r and q."""
        for_update, for_reset, for_candidate = context.chunk(3, dim=1)
        both = torch.cat([hidden, motion], dim=1)
        update = torch.sigmoid(self.convz(both) + for_update)
        reset = torch.sigmoid(self.convr(both) + for_reset)
        candidate = torch.tanh(self.convq(torch.cat([reset * hidden, motion], dim=1)) + for_candidate)
        return (1 - update) * hidden + update * candidate


class MotionEncoder(nn.Module):
    """Mixes correlations with the flow they were looked up at."""

    def __init__(self) -> None:
        super().__init__()
        self.convc1 = nn.Conv2d(LEVELS * (2 * RADIUS + 1), 64, 1)
        self.convc2 = nn.Conv2d(64, 64, 3, padding=1)
        self.convf1 = nn.Conv2d(2, 64, 7, padding=3)
        self.convf2 = nn.Conv2d(64, 64, 3, padding=1)
        self.conv = nn.Conv2d(64 + 64, MOTION - 2, 3, padding=1)

    def forward(self, flow: Tensor, correlation: Tensor) -> Tensor:
        """Flow (B, 2, H, W) and correlations to (B, MOTION, H, W)."""
        matched = functional.relu(self.convc2(functional.relu(self.convc1(correlation))))
        moved = functional.relu(self.convf2(functional.relu(self.convf1(flow))))
        return torch.cat([functional.relu(self.conv(torch.cat([matched, moved], dim=1))), flow], dim=1)


class FlowHead(nn.Module):
    """The step of the flow, from the state."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(HIDDEN, FLOW_WIDTH, 3, padding=1)
        self.conv2 = nn.Conv2d(FLOW_WIDTH, 2, 3, padding=1)

    def forward(self, hidden: Tensor) -> Tensor:
        """(B, HIDDEN, H, W) to (B, 1, H, W): nothing moves across rows, so the second channel is left out."""
        step: Tensor = self.conv2(functional.relu(self.conv1(hidden)))
        return step[:, :1]


class UpdateBlock(nn.Module):
    """The parts of one iteration."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = MotionEncoder()
        self.gru08 = ConvGru(MOTION)
        self.gru16 = ConvGru(HIDDEN)  # never run, as is the next
        self.gru32 = ConvGru(HIDDEN)
        self.flow_head = FlowHead()
        self.mask = nn.Sequential(nn.Conv2d(HIDDEN, MASK_WIDTH, 3, padding=1), nn.ReLU(), nn.Conv2d(MASK_WIDTH, 9 * FACTOR**2, 1))


class UpdateModule(nn.Module):
    """All iterations ('update_module')."""

    def __init__(self) -> None:
        super().__init__()
        self.update_block = UpdateBlock()

    def forward(self, rows: list[Tensor], hidden: Tensor, context: Tensor, iterations: int) -> Tensor:
        """Flow in pixels, (B, 1, FACTOR * H, FACTOR * W), from states (B, HIDDEN, H, W)."""
        block = self.update_block
        columns = torch.arange(hidden.shape[3], dtype=hidden.dtype)
        flow = hidden.new_zeros(hidden.shape[0], 1, *hidden.shape[2:])
        for _ in range(iterations):
            correlation = look_up(rows, columns + flow[:, 0])
            motion = block.encoder(torch.cat([flow, torch.zeros_like(flow)], dim=1), correlation)
            hidden = block.gru08(hidden, context, motion)
            flow = flow + block.flow_head(hidden)
        return upsample_convex(flow, 0.25 * block.mask(hidden))


def upsample_convex(flow: Tensor, weights: Tensor) -> Tensor:
    """Each pixel is a convex mixture of the 3x3 cells around its cell.

    Args:
        flow: in cells, (B, 1, H, W).
        weights: before their softmax over the nine cells, (B, 9 * FACTOR**2, H, W).

    Returns:
        Flow in pixels, (B, 1, FACTOR * H, FACTOR * W).
    """
    batch, _, height, width = flow.shape
    shares = torch.softmax(weights.view(batch, 9, FACTOR, FACTOR, height, width), dim=1)
    cells = functional.unfold(FACTOR * flow, 3, padding=1).view(batch, 9, 1, 1, height, width)
    mixed = (shares * cells).sum(dim=1)  # (B, FACTOR, FACTOR, H, W)
    return mixed.permute(0, 3, 1, 4, 2).reshape(batch, 1, FACTOR * height, FACTOR * width)


def correlation_rows(reference: Tensor, other: Tensor) -> list[Tensor]:
    """Correlations of every cell with every cell of its row, at all levels.

    Args:
        reference: features, (B, C, H, W).
        other: features of the other image, (B, C, H, W).

    Returns:
        (B, H, W, W_l + 2 * MARGIN) per level, the right cells averaged over 2**l columns.
    """
    per_row = reference.permute(0, 2, 3, 1)  # (B, H, W, C)
    products = torch.matmul(per_row, other.permute(0, 2, 1, 3)) * reference.shape[1] ** -0.5  # (B, H, W, W)
    rows = []
    for level in range(LEVELS):
        if level:
            products = functional.avg_pool2d(products, (1, 2), (1, 2))
        rows.append(functional.pad(products, (MARGIN, MARGIN)))
    return rows


def look_up(rows: list[Tensor], columns: Tensor) -> Tensor:
    """Correlations around given columns of the other image.

    Args:
        rows: as of `correlation_rows`.
        columns: where each cell is thought to lie in the other image, in cells, (B, H, W).

    Returns:
        (B, LEVELS * (2 * RADIUS + 1), H, W), linear between cells, 0 outside the image.
    """
    offsets = torch.arange(-RADIUS, RADIUS + 2)  # one more than is returned, for the interpolation
    correlations = []
    for level, products in enumerate(rows):
        centre = columns / 2**level
        below = torch.floor(centre)
        share = (centre - below)[..., None]  # (B, H, W, 1)
        index = below.clamp(RADIUS - MARGIN, products.shape[-1] - MARGIN - RADIUS - 2).long()
        cells = torch.gather(products, -1, (index + MARGIN)[..., None] + offsets)  # (B, H, W, 2 * RADIUS + 2)
        correlations.append(torch.lerp(cells[..., :-1], cells[..., 1:], share))
    return torch.cat(correlations, dim=-1).permute(0, 3, 1, 2)
