"""The texture bank of the stereo scenes: pictures, patterns and natural noise, each with its mip levels."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.synthetic.stereo.stereo_patterns import SIDE, coloured_pattern, grey_pattern

LEVELS = 7  # down to 4 x 4 texels
COLOURS, GREYS = 96, 24  # textures in the bank
SIZES = np.array([SIDE >> level for level in range(LEVELS + 1)], np.float32)  # sides of the levels, texels


@dataclass(frozen=True, eq=False)
class TextureBank:
    """Textures as chains of mip levels: the finest on the left, the others below each other on the right.

    Attributes:
        colours: chains of colour textures, each uint8 (SIDE, SIDE + SIDE / 2, 3).
        greys: chains of grey textures (grain, stains; mean near 128), each uint8 (SIDE, SIDE + SIDE / 2).
    """

    colours: list[Image8]
    greys: list[Image8]


@lru_cache(maxsize=1)
def texture_bank() -> TextureBank:
    """The bank, made at the first call in a process (a few seconds) and always the same."""
    colours = [_chain(coloured_pattern(np.random.default_rng([71, index]))) for index in range(COLOURS)]
    greys = [_chain(grey_pattern(np.random.default_rng([72, index]))) for index in range(GREYS)]
    return TextureBank(colours, greys)


def sample(chain: Image8, u: Map, v: Map, footprint: Map) -> Map:
    """Trilinear look-up of a texture that continues mirrored beyond its borders.

    Args:
        chain: one of a bank's textures.
        u: position along the columns, texels of the finest level, (N,), N < 32767.
        v: position along the rows.
        footprint: texels of the finest level that one pixel covers, (N,).

    Returns:
        Values in [0, 255], float32 (N, 3) or (N,).
    """
    u, v = _mirrored(u), _mirrored(v)
    if footprint.max() <= 1:
        return _at_level(chain, u, v, np.float32(SIDE))
    level = np.minimum(np.log2(np.maximum(footprint, np.float32(1))), np.float32(LEVELS - 1))
    finer = level.astype(np.int32)
    share = level - finer
    size = SIZES.take(finer)
    fine = _at_level(chain, u, v, size)
    coarse = _at_level(chain, u, v, size * np.float32(0.5))
    coarse -= fine
    coarse *= share[:, None] if chain.ndim == 3 else share
    coarse += fine
    return coarse


def _mirrored(position: Map) -> Map:
    """Fold a position on an endless line into [0, SIDE]."""
    turns = position * np.float32(0.5 / SIDE)
    turns -= np.floor(turns + np.float32(0.5))
    return np.abs(turns) * np.float32(2 * SIDE)


def _at_level(chain: Image8, u: Map, v: Map, size: Map | np.float32) -> Map:
    """Bilinear look-up at the mip level of a side in texels, per sample or for all; (N, 3) or (N,)."""
    scale, last = size * np.float32(1 / SIDE), size - 1
    x, y = (np.minimum(np.maximum(a * scale - np.float32(0.5), np.float32(0)), last) for a in (u, v))
    x += np.float32(SIDE) * (size < SIDE)
    y += np.maximum(SIDE - 2 * size, np.float32(0))
    values = cv2.remap(chain, x[None], y[None], cv2.INTER_LINEAR)
    return values[0].astype(np.float32)


def _chain(finest: Image8) -> Image8:
    chain = np.zeros((SIDE, SIDE + SIDE // 2, *finest.shape[2:]), np.uint8)
    chain[:, :SIDE] = image = finest
    for level in range(1, LEVELS + 1):
        side, top = SIDE >> level, SIDE - 2 * (SIDE >> level)
        image = np.asarray(cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA), np.uint8)
        chain[top : top + side, SIDE : SIDE + side] = image
    return chain
