"""Pairs of cameras that are compared, and the points they share."""

from collections.abc import Iterable, Sequence

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.epipolar import MatchedPair, match_pair
from ggvs_eval.pipelines.inspection.capture.camera_record import CameraRecord
from ggvs_eval.progress import track

ITERATIONS = 30
SMALLEST_RESIDUAL = 1e-3


def match_pairs(
    cameras: Sequence[Camera], records: Sequence[CameraRecord], pairs: Iterable[tuple[int, int]]
) -> list[MatchedPair]:
    """Match the first frames of each pair; pairs that share too little are left out."""
    matches = []
    for i, j in track(list(pairs), "matching neighbours"):
        one, other = records[i].features, records[j].features
        if one is not None and other is not None:
            matches.append(match_pair(i, j, one, other, max(*cameras[i].size, *cameras[j].size)))
    return [pair for pair in matches if pair is not None]


def solve_differences(count: int, pairs: Sequence[tuple[int, int]], differences: Array, weights: Array) -> Array:
    """Values x with x[i] - x[j] as near to the measured differences as can be; wrong pairs are outvoted.

    Args:
        pairs: (i, j) of each measurement.
        differences: measured x[i] - x[j], (P,).
        weights: trust in each, positive, (P,).

    Returns:
        (count,) values whose median is 0; NaN for cameras that no chain of pairs connects with the largest group.

    Reading:
        The sum of weighted absolute residuals is minimised (least squares, reweighted): a few pairs with gross errors leave no
        trace, where a plain least-squares solution would spread them over the rig.
    """
    values = np.full(count, np.nan)
    group = largest_group(count, pairs)
    kept = [row for row, (i, j) in enumerate(pairs) if i in group]
    if not kept:
        return values
    position = {camera: column for column, camera in enumerate(group)}
    rows = np.zeros((len(kept), len(group)))
    for row, pair in enumerate(kept):
        i, j = pairs[pair]
        rows[row, position[i]], rows[row, position[j]] = 1.0, -1.0
    values[group] = _least_absolute(rows, differences[kept], weights[kept])
    return values - np.nanmedian(values)


def largest_group(count: int, pairs: Sequence[tuple[int, int]]) -> list[int]:
    """The largest set of cameras that pairs connect, in order; the first of equals."""
    label = list(range(count))
    for i, j in pairs:
        old, new = label[i], label[j]
        label = [new if value == old else value for value in label]
    largest = max(label, key=label.count, default=0)
    return [camera for camera in range(count) if label[camera] == largest]


def _least_absolute(rows: Array, differences: Array, weights: Array) -> Array:
    """Reweighted least squares by normal equations; the common value, which differences leave open, is held at 0."""
    trust = weights.copy()
    solution: Array = np.zeros(rows.shape[1])
    for _ in range(ITERATIONS):
        weighted = rows * trust[:, None]
        normal = rows.T @ weighted + trust.mean() / rows.shape[1]
        solution = np.asarray(np.linalg.solve(normal, weighted.T @ differences), np.float64)
        trust = weights / np.maximum(np.abs(rows @ solution - differences), SMALLEST_RESIDUAL)
    return solution
