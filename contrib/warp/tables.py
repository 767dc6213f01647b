"""Tables that depend only on sizes: the cells of images and their enlargement.

Computed once per recording.
"""

from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import cv2
import numpy as np
import torch
import warp as wp
from torch import Tensor

from ggvs_eval.arrays import Array
from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS
from ggvs_eval.geometry import difference_mask
from ggvs_eval.pipelines.online import temporal_filters as rules

wp.set_module_options(MODULE_OPTIONS)

Size = tuple[int, int]  # width and height


@dataclass(frozen=True)
class Sizes:
    """Sizes of a step, by which all its arrays are laid out.

    Attributes:
        views: of the sources, nearest first.
        target: of the view that is rendered.
        scale: how many times fewer pixels the network works on, per side.
    """

    views: tuple[Size, ...]
    target: Size
    scale: int

    @property
    def largest(self) -> Size:
        """Of a stack that holds every view."""
        return max(width for width, _ in self.views), max(height for _, height in self.views)

    @property
    def pairs(self) -> int:
        """Pairs of sources; an empty one where there is but one source, so that no array is
        empty.
        """
        return max(len(self.views) * (len(self.views) - 1) // 2, 1)

    def lattice(self, by: int, rows: int) -> list[tuple[int, int, int]]:
        """Return the step, columns and rows of the lattice of each view's reduced image.

        At least N rows, if it has them.
        """
        lattices = []
        for view in self.views:
            width, height = (max(side // by, 1) for side in view)
            step = max(height // rows, 1)
            lattices.append(
                (step, len(range(step // 2, width, step)), len(range(step // 2, height, step)))
            )
        return lattices

    @property
    def network(self) -> Size:
        """Of the network's maps."""
        return -(-self.target[0] // self.scale), -(-self.target[1] // self.scale)

    @property
    def cells(self) -> Size:
        """Of maps of stillness."""
        return -(-self.target[0] // rules.REDUCTION), -(-self.target[1] // rules.REDUCTION)

    @property
    def mask_cells(self) -> tuple[Size, ...]:
        """Cells of each source's difference mask."""
        by = difference_mask.REDUCTION
        return tuple((max(width // by, 1), max(height // by, 1)) for width, height in self.views)


class Tables:
    """Tables of a device, each made when it is asked for first and kept.

    Args:
        sizes: of the step.
        device: of the tables.
    """

    def __init__(self, sizes: Sizes, device: torch.device) -> None:
        self.sizes, self.device = sizes, device
        self.view_sizes = self.tensor(sizes.views)
        self.mask_cells = self.tensor(sizes.mask_cells)
        self.pairs = cache(self.pairs)  # type: ignore[method-assign]
        self.lattices = cache(self.lattices)  # type: ignore[method-assign]
        self.past_size = cache(self.past_size)  # type: ignore[method-assign]
        self.area_cells = cache(self.area_cells)  # type: ignore[method-assign]
        self.between_cells = cache(self.between_cells)  # type: ignore[method-assign]
        self.middles = cache(self.middles)  # type: ignore[method-assign]
        self.past_size(*sizes.target)  # made now: a first instant may read a state of another size
        self.widening = cache(self.widening)  # type: ignore[method-assign]
        self.pooling = cache(self.pooling)  # type: ignore[method-assign]

    def tensor(self, values: Any) -> Tensor:
        """Return the numbers on the device: whole ones int32, others float32."""
        array = np.asarray(values)
        return torch.from_numpy(
            array.astype(np.int32 if array.dtype.kind in "iu" else np.float32)
        ).to(self.device)

    def pairs(self) -> tuple[Tensor, Tensor]:
        """Return both sources of each pair, (P, 2), and the ordered pairs, there and back, (2 P,
        2).
        """
        pairs = list(combinations(range(len(self.sizes.views)), 2)) or [(0, 0)]
        return self.tensor(pairs), self.tensor(
            [order for j, k in pairs for order in ((j, k), (k, j))]
        )

    def lattices(self, by: int, rows: int) -> Tensor:
        """`Sizes.lattice` of each view, (K, 3)."""
        return self.tensor(self.sizes.lattice(by, rows))

    def past_size(self, width: int, height: int) -> Tensor:
        """Return the size of the march of the instant before, (1, 2)."""
        return self.tensor([[width, height]])

    def area_cells(
        self, lengths: tuple[int, ...], counts: tuple[int, ...]
    ) -> tuple[Tensor, Tensor]:
        """Cut lines of pixels into equal cells: first and last pixel of each, (N, cells, 2), and
        their shares, (N, cells, n).
        """
        cut = [_area_cells(*pair) for pair in zip(lengths, counts, strict=True)]
        ends = np.zeros((len(cut), max(counts), 2), np.int64)
        shares = np.zeros((len(cut), max(counts), max(part.shape[1] for _, part in cut)))
        for n, (end, share) in enumerate(cut):
            ends[n, : len(end)], shares[n, : len(share), : share.shape[1]] = end, share
        return self.tensor(ends), self.tensor(shares)

    def between_cells(self, fine: int, coarse: int) -> tuple[Tensor, Tensor]:
        """Places of fine pixels between coarse ones: the two neighbours, (fine, 2), and the share
        of the second, (fine,).
        """
        at = np.clip((np.arange(fine) + 0.5) * coarse / fine - 0.5, 0.0, coarse - 1.0)
        first = at.astype(int)
        return self.tensor(
            np.stack([first, np.minimum(first + 1, coarse - 1)], axis=1)
        ), self.tensor(at - first)

    def middles(self, lengths: tuple[int, ...], counts: tuple[int, ...]) -> Tensor:
        """Return the pixel in the middle of each cell of lines, (N, cells)."""
        places = np.zeros((len(lengths), max(counts)), np.int64)
        for n, pair in enumerate(zip(lengths, counts, strict=True)):
            places[n, : pair[1]] = rules.middles(*pair)
        return self.tensor(places)

    def widening(self, size: int) -> Tensor:
        """Return the matrix that averages a line of cells over areas as wide as light, as cv2's
        resize and blur do.
        """
        small = -(-size // (rules.LIGHT_PX // rules.REDUCTION))
        lines: Array = np.eye(size, dtype=np.float64)
        averaged = cv2.resize(lines, (size, small), interpolation=cv2.INTER_AREA)
        return self.tensor(cv2.GaussianBlur(averaged, (1, 9), sigmaX=1, sigmaY=1))

    def pooling(self, size: int) -> Tensor:
        """Return the matrix that blurs a line of cells over the window of the changes of views."""
        lines: Array = np.eye(size, dtype=np.float64)
        taps = round(8 * rules.POOL + 1) | 1
        return self.tensor(cv2.GaussianBlur(lines, (1, taps), sigmaX=rules.POOL, sigmaY=rules.POOL))

    def wide(self, maps: Tensor) -> Tensor:
        """Return the sums of maps (..., h, w) over areas as wide as light."""
        down, across = (self.widening(size) for size in maps.shape[-2:])
        return (down @ maps @ across.T).contiguous()

    def pooled(self, maps: Tensor) -> Tensor:
        """Return the means of maps (..., h, w) over the window of the changes of views."""
        down, across = (self.pooling(size) for size in maps.shape[-2:])
        return (down @ maps @ across.T).contiguous()


def _area_cells(length: int, cells: int) -> tuple[Any, Any]:
    size = length / cells
    begins = np.arange(cells) * size
    ends = np.minimum((np.arange(cells) + 1) * size, length)
    # Overlaps below a millionth of a pixel are the rounding of begin and end.
    first, last = (begins + 1e-6).astype(int), np.minimum(np.ceil(ends - 1e-6).astype(int), length)
    pixels = first[:, None] + np.arange((last - first).max())
    overlaps = np.minimum(pixels + 1.0, ends[:, None]) - np.maximum(pixels, begins[:, None])
    return np.stack([first, last], axis=1), np.where(pixels < last[:, None], overlaps / size, 0)


def masked_median(values: Tensor, mask: Tensor) -> Tensor:
    """Return the median of the values that count, the mean of the two middle ones of an even
    number; 0 if none does.

    Torch's own reads it back, or takes at most 16 million values.

    Args:
        values: of any shape.
        mask: what counts, of the same shape.

    Returns:
        (1,), on the device.
    """
    ordered = torch.where(mask, values, torch.inf).flatten().sort().values
    count = mask.sum().reshape(1)
    low, high = (
        ordered.gather(0, place)
        for place in ((count - 1).clamp(min=0) // 2, (count // 2).clamp(max=len(ordered) - 1))
    )
    return torch.where(count > 0, (low + high) / 2, 0.0)


@wp.func
def falling(value: wp.float32, first: wp.float32, last: wp.float32) -> wp.float32:
    """1 up to the first limit, 0 from the last one on, a line between them."""
    return wp.clamp((last - value) / (last - first), 0.0, 1.0)


@wp.struct
class Corners:
    """The four pixels around a place in an image, and its share of the right and of the
    lower ones.
    """

    x0: wp.int32
    x1: wp.int32
    y0: wp.int32
    y1: wp.int32
    fx: wp.float32
    fy: wp.float32


@wp.func
def corners_around(
    row: wp.float32, column: wp.float32, height: wp.int32, width: wp.int32
) -> Corners:
    """Return the corners of a place in pixels, 0 in the middle of the first.

    The last pixel repeats beyond the image.
    """
    corners = Corners()
    corners.y0 = wp.min(wp.int32(row), height - 1)
    corners.x0 = wp.min(wp.int32(column), width - 1)
    corners.y1 = wp.min(corners.y0 + 1, height - 1)
    corners.x1 = wp.min(corners.x0 + 1, width - 1)
    corners.fy = row - wp.float32(corners.y0)
    corners.fx = column - wp.float32(corners.x0)
    return corners


@wp.func
def enlarged_place(pixel: wp.int32, step: wp.float32) -> wp.float32:
    """Map a pixel of an enlarged image to the small one, with pixels `step` apart, as torch
    enlarges.
    """
    return wp.max((wp.float32(pixel) + 0.5) * step - 0.5, 0.0)


@wp.func
def enlarged(
    maps: wp.array2d[wp.float32],
    h: wp.int32,
    w: wp.int32,
    y: wp.int32,
    x: wp.int32,
    height: wp.int32,
    width: wp.int32,
):
    """Bilinear value of a small map (h, w) at a pixel of a larger one (height, width), as torch
    enlarges.
    """
    v = enlarged_place(y, wp.float32(h) / wp.float32(height))
    u = enlarged_place(x, wp.float32(w) / wp.float32(width))
    n = corners_around(v, u, h, w)
    upper = (1.0 - n.fx) * maps[n.y0, n.x0] + n.fx * maps[n.y0, n.x1]
    lower = (1.0 - n.fx) * maps[n.y1, n.x0] + n.fx * maps[n.y1, n.x1]
    return (1.0 - n.fy) * upper + n.fy * lower
