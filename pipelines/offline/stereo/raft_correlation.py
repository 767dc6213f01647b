"""How well each cell of the left image matches the cells of its row in the right one, looked up around the current disparity."""

import torch
from torch import Tensor
from torch.nn import functional

VOLUME_BYTES = 512 * 2**20  # a larger volume is not kept but computed again for every lookup, row by row


def at_least_single(tensor: Tensor) -> Tensor:
    """The tensor in single precision where it had less; positions need it although features do not."""
    return tensor.to(torch.promote_types(tensor.dtype, torch.float32))


class Correlation:
    """Correlation of two feature maps, averaged over 1, 2, 4, ... cells of the right row.

    Averaging correlations equals correlating with averaged features, so that the levels need not be kept: where the volume would
    be larger than `volume_bytes`, each lookup computes it again for as many rows at a time as fit.

    Args:
        left: (B, C, H, W).
        right: (B, C, H, W).
        levels: number of averages.
        radius: cells looked up on either side.
        volume_bytes: memory for the volume.
    """

    def __init__(self, left: Tensor, right: Tensor, levels: int, radius: int, volume_bytes: int = VOLUME_BYTES) -> None:
        self.radius = radius
        self._left = left.permute(0, 2, 3, 1)  # (B, H, W, C)
        pyramid = [right]
        for _ in range(1, levels):
            pyramid.append(functional.avg_pool2d(pyramid[-1], (1, 2), (1, 2)))
        self._right = [level.permute(0, 2, 1, 3) for level in pyramid]  # (B, H, C, W_l) each
        batch, height, width, _ = self._left.shape
        row_bytes = batch * width * sum(level.shape[-1] + 2 * self._margin for level in self._right) * 4
        self._rows = max(1, volume_bytes // row_bytes)
        self._volume = self._rows_of_volume(0, height) if self._rows >= height else None

    def lookup(self, columns: Tensor) -> Tensor:
        """Correlations around given columns of the right image.

        Args:
            columns: where each left cell is thought to lie in the right image, in cells, (B, H, W).

        Returns:
            (B, levels * (2 * radius + 1), H, W), linear between cells, 0 outside the image.
        """
        height = columns.shape[1]
        if self._volume is not None:
            return self._sample(self._volume, columns)
        bands = [slice(row, min(row + self._rows, height)) for row in range(0, height, self._rows)]
        looked_up = [self._sample(self._rows_of_volume(band.start, band.stop), columns[:, band]) for band in bands]
        return torch.cat(looked_up, dim=2)

    @property
    def _margin(self) -> int:
        """Zeros on either side of a row, so that a lookup outside the image finds them."""
        return 2 * self.radius + 2

    def _rows_of_volume(self, start: int, stop: int) -> list[Tensor]:
        """Correlations of some rows at all levels, (B, rows, W, W_l + 2 margins) each, float32."""
        scale = self._left.shape[-1] ** -0.5
        volume = []
        for right in self._right:
            products = at_least_single(torch.matmul(self._left[:, start:stop], right[:, start:stop])) * scale
            volume.append(functional.pad(products, (self._margin, self._margin)))
        return volume

    def _sample(self, volume: list[Tensor], columns: Tensor) -> Tensor:
        """Linear interpolation at 2 * radius + 1 columns per cell and level."""
        offsets = torch.arange(-self.radius, self.radius + 2, device=columns.device)  # one more than is returned
        sampled = []
        for level, products in enumerate(volume):
            centre = columns / 2**level
            below = torch.floor(centre)
            share = (centre - below)[..., None]  # (B, H, W, 1)
            index = below.clamp(self.radius - self._margin, products.shape[-1] - self._margin - self.radius - 2).long()
            index = (index + self._margin)[..., None] + offsets  # (B, H, W, 2 * radius + 2)
            cells = torch.gather(products, -1, index)
            sampled.append(torch.lerp(cells[..., :-1], cells[..., 1:], share))
        return torch.cat(sampled, dim=-1).permute(0, 3, 1, 2)
