"""Changes between frames in blocks of 8 x 8 pixels: static blocks, and the grain of the changes in
them.
"""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.errors import MetricError

Field = NDArray[np.float32]

BLOCK_PX = 8
SCALES_PX = (1, 2, 4, 8, 16, 32)  # grains of noise that are distinguished
N_LEVELS = 8  # bins of brightness
MIN_BLOCKS = 40
MIN_SQUARES = 8  # of 16 or 32 pixels
# of 8-bit values, grey levels squared; rounding adds it again to what is drawn
ROUNDING_VARIANCE = 1.0 / 12.0
MAX_SIGMA_255 = 12.0  # what changes more is not taken for noise
MIN_LIMIT = 0.25  # grey levels squared; below it a block counts as still in any case
ENERGY_EDGES = np.concatenate([[-np.inf], 2.0 ** np.arange(-6, 13.01, 0.25), [np.inf]])
N_ENERGIES = len(ENERGY_EDGES) - 1
MIN_LIMIT_BIN = int(np.searchsorted(ENERGY_EDGES, MIN_LIMIT)) - 1
# the order in which a covariance of RGB is stored
PLANES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


def check_frame(frame: Image8, shape: tuple[int, ...] = ()) -> None:
    """Refuse anything but an 8-bit RGB frame of at least 16 x 16 pixels, of the shape of the frames
    before it.
    """
    if (
        frame.dtype != np.uint8
        or frame.ndim != 3
        or frame.shape[-1] != 3
        or min(frame.shape[:2]) < 2 * BLOCK_PX
    ):
        expected_shape = f"(height, width, 3) uint8, sides at least {2 * BLOCK_PX}"
        raise MetricError(
            f"wanted frames {expected_shape}, got {frame.shape} {frame.dtype}; give 8-bit RGB "
            f"frames"
        )
    if shape and frame.shape != shape:
        raise MetricError(
            f"frames of one view: {shape} before, {frame.shape} now; give all frames one size"
        )


def block_means(planes: NDArray, size: int = BLOCK_PX) -> Field:
    """Means over blocks of size x size pixels, (H // size, W // size, ...).

    What is left at the right and below is not used.
    """
    rows, columns = (side // size for side in planes.shape[:2])
    cropped = planes[: rows * size, : columns * size]
    return np.asarray(
        cv2.resize(cropped, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32
    )


def static_limit(histogram: NDArray) -> int:
    """Return the last bin of block energies that noise explains.

    Args:
        histogram: blocks per bin of `ENERGY_EDGES`, (E,).

    Returns:
        Index of a bin. Blocks below the peak of the histogram give the width of the peak: motion
        only adds energy. Three such widths above the peak, at most a factor of 8, noise ends.
    """
    last = int(np.searchsorted(ENERGY_EDGES, MAX_SIGMA_255**2)) - 1
    weights = np.exp(-0.5 * (np.arange(-4, 5) / 1.5) ** 2)
    smooth = np.convolve(histogram[1 : last + 1], weights / weights.sum(), mode="same")
    if smooth.sum() <= 0.1 * histogram[0]:  # a video without noise, or nearly
        return MIN_LIMIT_BIN
    peak = 1 + int(np.argmax(smooth))
    below = np.arange(1, peak + 1)
    spread = np.sqrt(np.average((below - peak) ** 2, weights=histogram[below] + 1e-9))
    reach = int(np.clip(np.ceil(3 * spread), 2, 12))  # 12 bins of a quarter octave: a factor of 8
    return max(MIN_LIMIT_BIN, min(peak + reach, last))


class ChangeTable:
    """Sums over blocks of the products of changes, by brightness and energy, so that the limit can
    be chosen at the end.
    """

    def __init__(self) -> None:
        fine, coarse = SCALES_PX.index(BLOCK_PX) + 1, len(SCALES_PX) - SCALES_PX.index(BLOCK_PX) - 1
        # a count, then the covariance at each scale
        self._fine = np.zeros((N_LEVELS, N_ENERGIES, 1 + 6 * fine))
        # a count, at half this scale, at this scale
        self._coarse = np.zeros((coarse, N_LEVELS, N_ENERGIES, 1 + 2 * 6))
        # luma, energy, own brightness: a count, squares
        self._by_level = np.zeros((3, N_LEVELS, N_ENERGIES, N_LEVELS, 2))

    @property
    def n_blocks(self) -> int:
        """Blocks seen."""
        return int(self._fine[..., 0].sum())

    def limits(self) -> NDArray[np.int64]:
        """The last static bin of energy at each brightness, (N_LEVELS,).

        Rare ones take that of the nearest frequent one.
        """
        histograms = self._fine[..., 0]
        overall = static_limit(histograms.sum(axis=0))
        frequent = np.flatnonzero(histograms.sum(axis=1) >= 4 * MIN_BLOCKS)
        # without noise, or nearly, the only peaks are those of motion
        if overall <= MIN_LIMIT_BIN or not len(frequent):
            return np.full(N_LEVELS, overall)
        nearest = frequent[np.abs(np.arange(N_LEVELS)[:, None] - frequent).argmin(axis=1)]
        return np.array([static_limit(histograms[level]) for level in nearest])

    def n_within(self, limits: NDArray[np.int64]) -> int:
        """Return the blocks that count as static under these limits."""
        return int(self._fine[_within(limits)][:, 0].sum())

    def add(self, later: Image8, earlier: Image8) -> None:
        """Take two frames of the same view."""
        # its square has the noise's variance
        change = cv2.subtract(later, earlier, dtype=cv2.CV_32F) * np.float32(np.sqrt(0.5))
        products = [block_means(_products(change), BLOCK_PX)]
        shrunk = change
        for scale in SCALES_PX[1:]:
            shrunk = block_means(shrunk, 2)
            products.append(
                block_means(_products(shrunk), BLOCK_PX // scale)
                if scale <= BLOCK_PX
                else _products(shrunk)
            )
        colours = (block_means(later) + block_means(earlier)) / 2
        energy = products[0][..., :3].mean(axis=-1)
        bins = np.searchsorted(ENERGY_EDGES, energy, side="right") - 1
        self._add_fine(bins, colours, products[: SCALES_PX.index(BLOCK_PX) + 1])
        for index, finer_scale in enumerate(range(SCALES_PX.index(BLOCK_PX), len(SCALES_PX) - 1)):
            bins, colours = _pooled(bins, np.maximum), _pooled(colours, np.add) / 4
            columns = np.concatenate(
                [_pooled(products[finer_scale], np.add) / 4, products[finer_scale + 1]], axis=-1
            )
            self._coarse[index] += _sums(levels_of(colours.mean(axis=-1)), bins, columns)

    def covariance(self, limits: NDArray[np.int64]) -> Array:
        """Return the covariance of RGB noise of single pixels, (3, 3), grey levels squared."""
        sums = self._fine[_within(limits)].sum(axis=0)
        return _matrix(sums[1:7] / max(sums[0], 1))

    def variances(self, limits: NDArray[np.int64], axes: Array) -> Array:
        """Variance along each axis of noise averaged over squares of each of `SCALES_PX`, (S, 3),
        grey levels squared.
        """
        sums = self._fine[_within(limits)].sum(axis=0)
        variances = [_along(plane, axes) for plane in sums[1:].reshape(-1, 6) / max(sums[0], 1)]
        for table in self._coarse:
            sums = table[_within(limits)].sum(axis=0)
            finer, coarser = (_along(plane, axes) for plane in sums[1:].reshape(2, 6))
            enough = (sums[0] >= MIN_SQUARES) & (finer > 0)
            # a quarter: white noise
            ratio = np.where(enough, coarser / np.where(enough, finer, 1), 0.25)
            variances.append(variances[-1] * ratio)
        return np.array(variances)

    def variance_by_level(self, limits: NDArray[np.int64]) -> Array:
        """Variance of each channel at each brightness of that channel, (N_LEVELS, 3).

        Interpolated where none was seen.
        """
        # (N_LEVELS, 3) each
        counts, squares = self._by_level[:, _within(limits)].sum(axis=1).transpose(2, 1, 0)
        enough = counts >= np.minimum(MIN_BLOCKS, counts.max(axis=0))
        curves = [
            (np.flatnonzero(enough[:, c]), squares[enough[:, c], c] / counts[enough[:, c], c])
            for c in range(3)
        ]
        return np.stack([np.interp(np.arange(N_LEVELS), *curve) for curve in curves], axis=-1)

    def _add_fine(self, bins: NDArray[np.int64], colours: NDArray, products: list[Field]) -> None:
        luma = levels_of(colours.mean(axis=-1))
        self._fine += _sums(luma, bins, np.concatenate(products, axis=-1))
        for c in range(3):
            key = (luma * N_ENERGIES + bins) * N_LEVELS + levels_of(colours[..., c])
            for column, weights in enumerate(
                (np.ones_like(products[0][..., c]), products[0][..., c])
            ):
                sums = np.bincount(
                    key.ravel(), weights.ravel(), minlength=N_LEVELS * N_ENERGIES * N_LEVELS
                )
                self._by_level[c, ..., column] += sums.reshape(N_LEVELS, N_ENERGIES, N_LEVELS)


def level_centres() -> Array:
    """Centres of the bins of brightness, grey levels of 255."""
    return (np.arange(N_LEVELS) + 0.5) * 256 / N_LEVELS - 0.5


def levels_of(values: NDArray) -> NDArray[np.int64]:
    """Bins of brightness of values in 0..255."""
    return np.clip(values * (N_LEVELS / 256), 0, N_LEVELS - 1).astype(np.int64)


def _within(limits: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the mask of the static bins of brightness and energy, (N_LEVELS, N_ENERGIES)."""
    return np.arange(N_ENERGIES) <= limits[:, None]


def _products(change: Field) -> Field:
    """Return the six different products of the channels, (H, W, 6), in the order of `PLANES`."""
    return np.concatenate([change * change, change * change[..., [1, 2, 0]]], axis=-1)


def _matrix(planes: Array) -> Array:
    matrix = np.zeros((3, 3))
    for value, (row, column) in zip(planes, PLANES, strict=True):
        matrix[row, column] = matrix[column, row] = value
    return matrix


def _pooled(blocks: NDArray, combine: np.ufunc) -> NDArray:
    """Return each two by two blocks combined to one; a last odd row or column is left out."""
    rows, columns = (side // 2 * 2 for side in blocks.shape[:2])
    even = blocks[:rows, :columns]
    return combine(
        combine(even[::2, ::2], even[1::2, ::2]), combine(even[::2, 1::2], even[1::2, 1::2])
    )


def _sums(level: NDArray[np.int64], energy: NDArray[np.int64], columns: Field) -> Array:
    """Return the counts and sums of each column by brightness and energy, (N_LEVELS, N_ENERGIES, 1
    + columns).
    """
    rows, width = level.shape
    key = (level * N_ENERGIES + energy).ravel()
    weights = columns[:rows, :width].reshape(len(key), -1).T
    sums = [
        np.bincount(key, weight, minlength=N_LEVELS * N_ENERGIES)
        for weight in (np.ones(len(key)), *weights)
    ]
    return np.stack(sums, axis=-1).astype(np.float64).reshape(N_LEVELS, N_ENERGIES, -1)


def _along(planes: Array, axes: Array) -> Array:
    """Return the variances along the axes, (3,), of a covariance stored as `PLANES`."""
    return np.einsum("ia,ij,ja->a", axes, _matrix(planes), axes)


def octaves(variances: Array) -> Array:
    """Variance of each grain, (S, 3), without that of rounding: the mixture whose means over
    squares vary as measured, (S, 3).
    """
    from scipy.optimize import nnls

    response = octave_responses()[0]
    white = variances[:1] / np.array(SCALES_PX)[:, None] ** 2.0
    # about the same relative weight for every scale
    weight = 1 / np.maximum(variances, np.maximum(0.1 * white, 1e-9))
    columns = [
        nnls(response * weight[:, a, None], variances[:, a] * weight[:, a], maxiter=1000)[0]
        for a in range(3)
    ]
    octaves = np.stack(columns, axis=-1)
    octaves[0] = np.maximum(octaves[0] - ROUNDING_VARIANCE, 0)
    return octaves


def enlarged(coarse: Field, grain: int) -> Field:
    """Return a field of blocks of `grain` pixels, one value per pixel."""
    if grain == 1:
        return coarse
    return np.asarray(
        cv2.resize(coarse, None, fx=grain, fy=grain, interpolation=cv2.INTER_CUBIC),
        dtype=np.float32,
    )


@lru_cache(maxsize=1)
def _octave_curves() -> tuple[Array, Array]:
    """Along a line, for each grain: variance of means over each of `SCALES_PX`, (S, S), and
    covariance of neighbours, (S,).
    """
    length, inner = 512, slice(128, 384)
    variances, neighbours = np.zeros((len(SCALES_PX),) * 2), np.zeros(len(SCALES_PX))
    for octave, grain in enumerate(SCALES_PX):
        impulses = np.eye(length // grain)
        profile = (
            cv2.resize(impulses, (length // grain, length), interpolation=cv2.INTER_CUBIC)
            if grain > 1
            else impulses
        )
        for index, scale in enumerate(SCALES_PX):
            means = profile[inner].reshape(-1, scale, profile.shape[1]).mean(axis=1)
            variances[index, octave] = (means**2).sum(axis=1).mean()
        neighbours[octave] = (
            (profile[inner] * profile[inner.start + 1 : inner.stop + 1]).sum(axis=1).mean()
        )
    return variances, neighbours


def octave_gains() -> Array:
    """Return the factor that scales noise of each grain to variance 1, (S,)."""
    return 1 / _octave_curves()[0][0]


def octave_responses() -> tuple[Array, Array]:
    """Variance of means over squares of each scale for noise of each grain and variance 1, (S, S),
    and its correlation, (S,).
    """
    variances, neighbours = _octave_curves()
    return (variances / variances[0]) ** 2, neighbours / variances[0]


def shares_of(octave_variance: Array) -> Array:
    """Return the share of each grain in the variance of all channels, (6,)."""
    total = octave_variance.sum()
    return octave_variance.sum(axis=1) / total if total > 0 else np.zeros(len(octave_variance))
