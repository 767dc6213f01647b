"""Arithmetic with the same bits on every processor, for what is filmed and for cameras.

BLAS sums in an order that depends on the processor, and so do OpenCV's filters; elementary
functions of NumPy and the C library differ in their last bit. Here every sum has one order, and
functions are made of operations that IEEE 754 rounds one way.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ggvs_eval.kernels import _film

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
# The cubic of OpenCV's and most others' filters; a sharper one rings.
CUBIC = -0.75
# A Gaussian is cut off beyond N standard deviations.
GAUSSIAN_REACH = 4


def product(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """Return the matrix product, (..., N, M) by (..., M, K), each sum from the first term to the
    last.

    Examples:
        >>> product(np.diag([2.0, 3.0]), np.array([[1.0, 2.0], [3.0, 4.0]])).tolist()
        [[2.0, 4.0], [9.0, 12.0]]
    """
    return np.einsum("...ij,...jk->...ik", left, right)


def transformed(matrix: NDArray[Any], vectors: NDArray[Any]) -> NDArray[Any]:
    """Return the vectors (..., M) after a matrix (N, M), (..., N)."""
    return np.einsum("ij,...j->...i", matrix, vectors)


def length(vectors: NDArray[Any]) -> NDArray[Any]:
    """Euclidean length of vectors (..., N), (...)."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def unit(vectors: NDArray[Any]) -> NDArray[Any]:
    """Return the vectors (..., N) at length 1; those of length 0 stay."""
    return vectors / np.maximum(length(vectors), 1e-30)[..., None]


def inverse(matrix: Array) -> Array:
    """Return the inverse of a matrix (3, 3), by its cofactors."""
    after, before = [1, 2, 0], [2, 0, 1]
    cofactors = (
        matrix[after][:, after] * matrix[before][:, before]
        - matrix[after][:, before] * matrix[before][:, after]
    )
    return cofactors.T / (cofactors[0] * matrix[0]).sum()


def sin(angle_rad: ArrayLike) -> Any:
    """Sine, to about one unit in the last place of a double; float32 in, float32 out."""
    return _number(_film.sin(np.asarray(angle_rad)))


def cos(angle_rad: ArrayLike) -> Any:
    """Return the cosine, as `sin`."""
    return _number(_film.cos(np.asarray(angle_rad)))


def exp(values: ArrayLike) -> Any:
    """Exponential function, as `sin`."""
    return _number(_film.exp(np.asarray(values)))


def power(bases: ArrayLike, exponents: ArrayLike) -> Any:
    """Powers of what is not negative; exponents are positive, one or one for each base."""
    return _number(_film.power(np.asarray(bases), np.asarray(exponents, np.float64)))


def arctan(slope: float) -> float:
    """Arcus tangent: three halvings of the angle, then its series.

    Examples:
        >>> round(4 * arctan(1.0), 12)
        3.14159265359
    """
    for _ in range(3):
        slope = slope / (1 + float(np.sqrt(1 + slope * slope)))
    square = slope * slope
    return 8 * slope * sum((-square) ** n / (2 * n + 1) for n in range(14))


def rotation_about(angle_rad: float, axis: Sequence[float] | Array) -> Array:
    """Return the rotation matrix about an axis of any length, (3, 3), after Rodrigues."""
    x, y, z = unit(np.asarray(axis, np.float64))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + sin(angle_rad) * cross + (1 - cos(angle_rad)) * product(cross, cross)


def rotation_by(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector: its axis, as long as its angle in radians,
    (3, 3).
    """
    return rotation_about(float(length(vector)), vector)


def rotation_vector(matrix: Array) -> Array:
    """Return the rotation vector of a rotation matrix that turns by less than half a turn, (3,)."""
    skew = (
        np.array(
            [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
        )
        / 2
    )
    sine, cosine = float(length(skew)), (matrix[0, 0] + matrix[1, 1] + matrix[2, 2] - 1) / 2
    return skew * (2 * arctan(sine / (1 + cosine)) / sine if sine else 1.0)


def shrink(image: NDArray[Any], height: int, width: int) -> Array32:
    """Reduce an image, (H, W, ...), to the means of equal areas, float32.

    Examples:
        >>> shrink(np.array([[1.0, 2.0, 6.0]]), 1, 2).tolist()
        [[1.3333333730697632, 4.666666507720947]]
    """
    rows = _means(np.asarray(image, np.float32), height)
    return np.ascontiguousarray(_means(rows.swapaxes(0, 1), width).swapaxes(0, 1))


def enlarge(grid: Array32, height: int, width: int) -> Array32:
    """Enlarge a grid, (h, w), by cubic convolution, its border repeated, float32."""
    return _interpolated(_interpolated(grid.T, width).T, height)


def blur(image: NDArray[Any], sigma_px: float) -> Array32:
    """Gaussian blur of an image, (H, W, ...), mirrored at its border, float32."""
    reach = int(np.rint(GAUSSIAN_REACH * sigma_px))
    weights = exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    weights = (weights / weights.sum()).astype(np.float32)
    image = np.asarray(image, np.float32)
    for _ in range(2):
        padded = np.pad(image, [(reach, reach)] + [(0, 0)] * (image.ndim - 1), mode="reflect")
        image = _weighted_sum(
            (padded[k : k + len(image)] for k in range(2 * reach + 1)), weights
        ).swapaxes(0, 1)
    return np.ascontiguousarray(image)


def _means(lines: Array32, count: int) -> Array32:
    """Return the means of `count` equal parts of the lines, (N, ...), (count, ...)."""
    size = len(lines) / count
    begin = np.arange(count) * len(lines) / count
    if size == int(size):
        step = int(size)
        return _weighted_sum(
            (lines[k::step] for k in range(step)), np.full(step, 1 / size, np.float32)
        )
    # (count, taps)
    index = np.floor(begin + 1e-9).astype(int)[:, None] + np.arange(int(np.ceil(size)) + 1)
    share = np.minimum(index + 1, begin[:, None] + size) - np.maximum(index, begin[:, None])
    weights = _column(np.clip(share, 0, None) / size, lines.ndim)
    return _weighted_sum((lines.take(tap, axis=0, mode="clip") for tap in index.T), weights)


def _interpolated(lines: Array32, count: int) -> Array32:
    """Cubic interpolation of lines, (N, ...), at the middles of `count` equal parts,
    (count, ...).
    """
    place = (np.arange(count) + 0.5) * len(lines) / count - 0.5
    first = np.floor(place)
    index = first[:, None].astype(int) + np.arange(-1, 3)
    away = np.abs(place[:, None] - index)
    near = ((CUBIC + 2) * away - (CUBIC + 3)) * away * away + 1
    far = CUBIC * (((away - 5) * away + 8) * away - 4)
    weights = _column(np.where(away <= 1, near, far), lines.ndim)
    return _weighted_sum((lines.take(tap, axis=0, mode="clip") for tap in index.T), weights)


def _column(weights: Array, axes: int) -> Array32:
    """Return the weights (count, taps) of lines with this many axes, one array for each tap."""
    return weights.T.astype(np.float32).reshape(weights.shape[::-1] + (1,) * (axes - 1))


def _weighted_sum(lines: Any, weights: Array32) -> Array32:
    total: Any = None
    for line, weight in zip(lines, weights, strict=True):
        part = line * weight
        total = part if total is None else np.add(total, part, out=total)
    return np.asarray(total)


def _number(values: NDArray[Any]) -> Any:
    """Return a float if there is one value alone, as NumPy's functions give it."""
    return values[()] if values.ndim == 0 else values
