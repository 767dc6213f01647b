"""How well each cell of one image matches the cells of its row in the other, looked up around the current match."""

import torch
from torch import Tensor
from torch.nn import functional

SIMD_LEVELS, RADIUS = 4, 4  # averages over 1, 2, 4, 8 cells; 4 cells looked up on either side
MARGIN = 2 * RADIUS + 2  # zeros on either side of a row, so that a lookup outside the image finds them


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
    for level in range(SIMD_LEVELS):
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
        (B, SIMD_LEVELS * (2 * RADIUS + 1), H, W), linear between cells, 0 outside the image.
    """
    offsets = torch.arange(-RADIUS, RADIUS + 2)  # one more than is returned, for the interpolation
    found = []
    for level, products in enumerate(rows):
        centre = columns / 2**level
        below = torch.floor(centre)
        share = (centre - below)[..., None]  # (B, H, W, 1)
        index = below.clamp(RADIUS - MARGIN, products.shape[-1] - MARGIN - RADIUS - 2).long()
        cells = torch.gather(products, -1, (index + MARGIN)[..., None] + offsets)  # (B, H, W, 2 * RADIUS + 2)
        found.append(torch.lerp(cells[..., :-1], cells[..., 1:], share))
    return torch.cat(found, dim=-1).permute(0, 3, 1, 2)
