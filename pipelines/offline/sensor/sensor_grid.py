"""The pixels of a depth sensor behind a depth map that was enlarged by repeating them, and back to an image's size."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Indices, Map

MOST_REPEATED = 8  # a column repeated more often is not a coarse sensor's, but a surface that looks alike all over
Places = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SensorLines:
    """Where the sensor's columns, or rows, lie in a depth map.

    Attributes:
        length: of the map, pixels.
        first: the first of the map's columns that shows each of the sensor's, (n,).
        centre: the middle of those that show it, pixels of the map, (n,).
    """

    length: int
    first: Indices
    centre: Places

    @property
    def pitch(self) -> float:
        """From one of the sensor's columns to the next, pixels of the map."""
        return float(np.median(np.diff(self.centre))) if len(self.centre) > 1 else 1.0

    def at(self, count: int) -> Places:
        """Which of the sensor's columns, with fractions, each of `count` columns over the same view looks at, (count,)."""
        return np.interp((np.arange(count) + 0.5) * self.length / count, self.centre, np.arange(len(self.first)))

    def seen_by(self, count: int) -> Indices:
        """Which of `count` columns over the same view looks at the middle of each of the sensor's, (n,)."""
        return (self.centre * count / self.length).astype(np.intp)


@dataclass(frozen=True, eq=False)
class SensorGrid:
    """The sensor's pixels in a depth map.

    Captures bring depth to the grid of their frames by repeating pixels (`DepthFrames`). Among repeated pixels neighbours tell
    nothing: every one stands beside others that agree with it.

    Attributes:
        rows: its rows.
        columns: its columns.
    """

    rows: SensorLines
    columns: SensorLines

    @staticmethod
    def find(depth: Map) -> "SensorGrid":
        """Find out how often rows and columns of a map are repeated, (H, W), 0 = unknown."""
        return SensorGrid(_find_lines(depth.T), _find_lines(depth))

    def reduce(self, depth: Map) -> Map:
        """The map on the sensor's pixels."""
        return depth[np.ix_(self.rows.first, self.columns.first)]

    def repeat(self, values: Map, width: int, height: int) -> Map:
        """Values on the sensor's pixels at the size of an image, (height, width): each of its pixels has the nearest one's."""
        return values[np.ix_(*(np.rint(at).astype(np.intp) for at in (self.rows.at(height), self.columns.at(width))))]

    def enlarge(self, depth: Map, image: Image8, step: float) -> Map:
        """Depth on the sensor's pixels at the size of an image, without a value between two surfaces.

        Args:
            depth: (h, w) on the sensor's pixels, 0 = unknown.
            image: what the camera saw of the same view, RGB, (H, W, 3).
            step: the four pixels around a place are one surface when they differ by at most this share.

        Returns:
            (H, W): unknown where the nearest of the four is; interpolated within a surface, in inverse depth, which is linear
            along a plane; else that of the four whose colour is most like the place's.
        """
        height, width = image.shape[:2]
        down, across = self.rows.at(height), self.columns.at(width)
        if np.array_equal(down, np.arange(depth.shape[0])) and np.array_equal(across, np.arange(depth.shape[1])):
            return depth
        guide = image[np.ix_(self.rows.seen_by(height), self.columns.seen_by(width))].astype(np.float32)
        top, left = down.astype(np.intp), across.astype(np.intp)
        below, right = np.minimum(top + 1, depth.shape[0] - 1), np.minimum(left + 1, depth.shape[1] - 1)
        taps = [np.ix_(row, column) for row in (top, below) for column in (left, right)]
        v, u = (down - top).astype(np.float32)[:, None], (across - left).astype(np.float32)
        weights = np.stack([(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u])  # (4, H, W)
        found = np.stack([depth[tap] for tap in taps])  # (4, H, W)
        unlike = np.stack([np.abs(guide[tap] - image).sum(axis=-1) for tap in taps])  # (4, H, W)
        likest = np.take_along_axis(found, np.where(found > 0, unlike, np.inf).argmin(axis=0)[None], axis=0)[0]
        low, high = found.min(axis=0), found.max(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            between = 1 / (weights / found).sum(axis=0)
        enlarged = np.where((low > 0) & (high - low <= step * low), between, likest)
        return np.where(self.repeat(depth, width, height) > 0, enlarged, np.float32(0)).astype(np.float32)


def _find_lines(depth: Map) -> SensorLines:
    """The sensor's columns; the map's own unless all are repeated equally often, give or take one."""
    length = depth.shape[1]
    known = np.count_nonzero(depth, axis=0) > 0
    begins = np.ones(length, np.bool_)
    begins[1:] = (depth[:, 1:] != depth[:, :-1]).any(axis=0) | ~known[1:]
    first = np.flatnonzero(begins)
    repeated = np.diff(np.append(first, length))
    inner = repeated[known[first]][1:-1]
    if inner.size == 0 or inner.max() > MOST_REPEATED or np.ptp(inner) > 1:
        first, repeated = np.arange(length), np.ones(length, np.intp)
    return SensorLines(length, first, first + repeated / 2)
