"""IV-PSNR in a page of numpy."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask

REACH_PX = 2
LUMA_WEIGHT = 4
BT709 = 0.2126, 0.7152, 0.0722


def iv_psnr_twin(
    rendered: Image8, truth: Image8, mask: Mask | None = None
) -> tuple[NDArray, NDArray, NDArray, int]:
    """What `_iv_psnr.matched_errors` computes of two YCbCr images."""
    x, y = rendered.astype(np.int64), truth.astype(np.int64)
    inside = np.ones(truth.shape[:2], bool) if mask is None else mask
    if not inside.any():
        return np.zeros((2, 3), np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64), 0
    mean = (x - y)[inside].mean(axis=0)
    # 1 % of 255, rounded
    shift = np.clip(np.sign(mean) * np.floor(np.abs(mean) + 0.5), -3, 3).astype(np.int64)
    sums = np.stack([_matched(x - shift, y, inside), _matched(y, x - shift, inside)])
    return sums, ((x - y) ** 2)[inside].sum(axis=0), shift, int(inside.sum())


def _matched(image: NDArray, candidates: NDArray, inside: Mask) -> NDArray:
    """Squared differences to the candidate within two pixels that is nearest in colour, row by row
    the first of equals, (3,).
    """
    height, width = inside.shape
    border = ((REACH_PX, REACH_PX),) * 2
    padded, allowed = (
        np.pad(candidates, (*border, (0, 0)), mode="edge"),
        np.pad(inside, border, mode="edge"),
    )
    least = np.full((height, width), np.iinfo(np.int64).max)
    best = np.zeros(image.shape, np.int64)
    for down in range(2 * REACH_PX + 1):
        for along in range(2 * REACH_PX + 1):
            there = slice(down, down + height), slice(along, along + width)
            squared = (image - padded[there]) ** 2
            cost = squared @ [LUMA_WEIGHT, 1, 1]
            is_better = allowed[there] & (cost < least)
            least[is_better], best[is_better] = cost[is_better], squared[is_better]
    return np.asarray(best[inside].sum(axis=0))


def ycbcr_twin(image: Image8) -> Image8:
    """8-bit BT.709 without headroom, of coefficients with sixteen binary digits."""
    red, green, blue = BT709
    to_blue, to_red = 0.5 / (blue - 1), 0.5 / (red - 1)
    rows = [
        [red, green, blue],
        [to_blue * red, to_blue * green, 0.5],
        [0.5, to_red * green, to_red * blue],
    ]
    fixed = np.rint(np.array(rows) * 2**16).astype(np.int64)
    levels = (image.astype(np.int64) @ fixed.T + 2**15) // 2**16 + [0, 128, 128]
    return np.clip(levels, 0, 255).astype(np.uint8)
