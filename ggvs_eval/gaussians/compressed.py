"""Clouds compressed as SuperSplat and gsplat write them: chunks of 256 Gaussians, whose numbers are steps between their bounds.

An element ``chunk`` of bounds, an element ``vertex`` of four packed words per Gaussian, and an element ``sh`` of one byte per
coefficient in the order of ``f_rest_`` where colours change with the direction.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.gaussians.harmonics import CONSTANT

COMPRESSED = ("chunk", "vertex", "sh")  # its elements, the last one where there is one
CHUNK_SIZE = 256
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
CHUNK = tuple(
    f"{end}_{axis}" for kind in ("", "scale_") for end in ("min", "max") for axis in (f"{kind}x", f"{kind}y", f"{kind}z")
)
SH_RANGE = 8.0  # coefficients lie within half of it on both sides of zero
LEAST_OPACITY = 1e-6  # the logit of 0 and 1 is infinite


def decompressed(chunks: NDArray[np.void], packed: NDArray[np.void], sh: NDArray[np.void] | None = None) -> NDArray[np.void]:
    """The rows of the same cloud in the layout of 3D Gaussian splatting.

    Args:
        chunks: bounds of each chunk, ``min_x`` ...
        packed: of each Gaussian, ``packed_position`` ...
        sh: coefficients of each, ``f_rest_0`` ...

    Reading:
        Positions and logarithms of scales have 11, 10 and 11 bits of x, y and z between their chunk's bounds; red, green, blue
        and opacity 8 bits each, colours between bounds too where the chunk has them. A quaternion names the largest of its four
        parts (w first) in 2 bits, and the others in 10 bits each, of +-sqrt(1/2).
    """
    of = np.arange(len(packed)) // CHUNK_SIZE

    def between(steps: Array, kind: str, axes: str) -> Array:
        low, high = (np.stack([chunks[f"{end}_{kind}{axis}"][of] for axis in axes], axis=1) for end in ("min", "max"))
        return np.asarray(low + steps * (high.astype(np.float64) - low))

    position, turn, scale, colour = (packed[name].astype(np.uint32) for name in PACKED)
    rgba = _parts(colour, (8, 8, 8, 8))
    rgb = between(rgba[:, :3], "", "rgb") if "min_r" in (chunks.dtype.names or ()) else rgba[:, :3]
    opacity = np.clip(rgba[:, 3], LEAST_OPACITY, 1 - LEAST_OPACITY)
    columns = {
        **_named("{}", "xyz", between(_parts(position, (11, 10, 11)), "", "xyz")),
        **_named("f_dc_{}", range(3), (rgb - 0.5) / CONSTANT),
        "opacity": np.log(opacity / (1 - opacity)),
        **_named("scale_{}", range(3), between(_parts(scale, (11, 10, 11)), "scale_", "xyz")),
        **_named("rot_{}", range(4), _quaternions(turn)),
    }
    if sh is not None:
        columns |= {name: ((sh[name] + 0.5) / 256 - 0.5) * SH_RANGE for name in sh.dtype.names or ()}
    rows = np.empty(len(packed), [(name, "f4") for name in columns])
    for name, values in columns.items():
        rows[name] = values
    return rows


def _parts(words: NDArray[np.uint32], bits: tuple[int, ...]) -> Array:
    """The numbers that share a word, the first in its highest bits, each in [0, 1], (N, len(bits))."""
    shifts = np.cumsum((0, *bits[:0:-1]))[::-1]
    return np.stack([(words >> shift & (1 << n) - 1) / ((1 << n) - 1) for shift, n in zip(shifts, bits, strict=True)], axis=1)


def _quaternions(words: NDArray[np.uint32]) -> Array:
    """Unit quaternions, w first, (N, 4)."""
    others = (_parts(words & (1 << 30) - 1, (10, 10, 10)) - 0.5) * np.sqrt(2)
    largest = np.sqrt(np.maximum(1 - np.square(others).sum(axis=1), 0))
    quaternions = np.empty((len(words), 4))
    for part in range(4):
        chosen = words >> 30 == part
        quaternions[chosen] = np.insert(others[chosen], part, largest[chosen], axis=1)
    return quaternions


def _named(form: str, keys: Iterable[object], values: Array) -> dict[str, Array]:
    return {form.format(key): column for key, column in zip(keys, values.T, strict=True)}
