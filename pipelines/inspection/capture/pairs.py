"""Pairs of cameras that are compared: the points they share, their epipolar errors, and which
cameras these accuse.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.epipolar import (
    SMALLEST_ANGLE_RAD,
    Features,
    MatchedPair,
    epipolar_errors,
    match_pair,
    ray_depths,
    sound_matches,
    tolerances,
)
from ggvs_eval.progress import track

ITERATIONS = 30
SMALLEST_RESIDUAL = 1e-3
# Baseline as a share of the depth below which the direction from one camera to the other is mostly
# noise.
LEAST_BASELINE = 0.005
# The same scene is in front of all cameras; matches behind one mean that its pose is turned away.
FRONT_SHARE = 0.5
# A pair is wrong if its median error exceeds the tolerance by this many standard errors.
SIGMAS = 2.0


def match_pairs(
    cameras: Sequence[Camera], features: Sequence[Features | None], pairs: Iterable[tuple[int, int]]
) -> list[MatchedPair]:
    """Match the frames of each pair of cameras; pairs that share too little are left out."""
    matches = []
    for i, j in track(list(pairs), "matching neighbours"):
        first, second = features[i], features[j]
        if first is not None and second is not None:
            matches.append(match_pair(i, j, first, second, max(*cameras[i].size, *cameras[j].size)))
    return [pair for pair in matches if pair is not None]


def solve_differences(
    count: int, pairs: Sequence[tuple[int, int]], differences: Array, weights: Array
) -> Array:
    """Return the values x with x[i] - x[j] as near to the measured differences as can be.

    Wrong pairs are outvoted.

    Args:
        pairs: (i, j) of each measurement.
        differences: measured x[i] - x[j], (P,).
        weights: trust in each, positive, (P,).

    Returns:
        (count,) values whose median is 0; NaN for cameras that no chain of pairs connects with the
        largest group.

    Reading:
        The sum of weighted absolute residuals is minimised (least squares, reweighted): a few pairs
        with gross errors leave no trace, where a plain least-squares solution would spread them
        over the rig.
    """
    values = np.full(count, np.nan)
    group = largest_group(count, pairs)
    pair_rows = [row for row, (i, j) in enumerate(pairs) if i in group]
    if not pair_rows:
        return values
    position = {camera: column for column, camera in enumerate(group)}
    rows = np.zeros((len(pair_rows), len(group)))
    for row, pair in enumerate(pair_rows):
        i, j = pairs[pair]
        rows[row, position[i]], rows[row, position[j]] = 1.0, -1.0
    values[group] = _least_absolute(rows, differences[pair_rows], weights[pair_rows])
    return values - np.nanmedian(values)


def solve_with_errors(
    count: int, pairs: Sequence[tuple[int, int]], differences: Array, sigmas: Array
) -> tuple[Array, Array]:
    """Return the values of `solve_differences`, (count,), and their standard errors, infinite if
    unknown.

    Args:
        sigmas: standard error of each difference, positive, (P,).

    Reading:
        Errors add up along a chain of pairs, as the inverse of the normal equations has it. Where
        residuals are larger than the differences' own errors allow, in the whole rig or among a
        camera's own pairs, its error grows by as much.
    """
    values, errors = (
        solve_differences(count, pairs, differences, 1 / sigmas),
        np.full(count, np.inf),
    )
    pair_rows = [row for row, (i, _) in enumerate(pairs) if np.isfinite(values[i])]
    if not pair_rows:
        return values, errors
    group = np.flatnonzero(np.isfinite(values))
    first, second = np.array([pairs[row] for row in pair_rows]).T
    rows = (first[:, None] == group).astype(float) - (second[:, None] == group)
    inverse = np.linalg.pinv(rows.T @ (rows / sigmas[pair_rows, None] ** 2), hermitian=True)
    strain = np.abs(values[first] - values[second] - differences[pair_rows]) / sigmas[pair_rows]
    freedom = max(len(pair_rows) - len(group) + 1, 1)
    common = 1.4826 * float(np.median(strain)) * np.sqrt(len(pair_rows) / freedom)
    for place, camera in enumerate(group):
        camera_strain = 1.4826 * float(np.median(strain[(first == camera) | (second == camera)]))
        errors[camera] = np.sqrt(max(inverse[place, place], 0.0)) * max(1.0, common, camera_strain)
    return values, errors


def largest_group(count: int, pairs: Sequence[tuple[int, int]]) -> list[int]:
    """Return the largest set of cameras that pairs connect, in order; the first of equals."""
    label = list(range(count))
    for i, j in pairs:
        old, new = label[i], label[j]
        label = [new if value == old else value for value in label]
    largest = max(label, key=label.count, default=0)
    return [camera for camera in range(count) if label[camera] == largest]


def _least_absolute(rows: Array, differences: Array, weights: Array) -> Array:
    """Reweighted least squares by normal equations.

    The common value, which differences leave open, is held at 0.
    """
    trust = weights.copy()
    solution: Array = np.zeros(rows.shape[1])
    for _ in range(ITERATIONS):
        weighted = rows * trust[:, None]
        normal = rows.T @ weighted + trust.mean() / rows.shape[1]
        solution = np.asarray(np.linalg.solve(normal, weighted.T @ differences), np.float64)
        trust = weights / np.maximum(np.abs(rows @ solution - differences), SMALLEST_RESIDUAL)
    return solution


@dataclass(frozen=True)
class PairError:
    """Epipolar error of one pair of cameras over its matches.

    Attributes:
        error_px: standard error of the median; small pictures have few matches.
        front_share: share of the matches that are in front of both cameras.
    """

    first: int
    second: int
    n_matches: int
    median_px: float
    error_px: float
    front_share: float


def has_parallax(first: Camera, second: Camera) -> bool:
    """Return whether two cameras are far enough apart for meaningful epipolar lines."""
    depth = min(np.sqrt(camera.near * camera.far) for camera in (first, second))
    return float(np.linalg.norm(first.centre - second.centre)) > LEAST_BASELINE * depth


def pair_error(cameras: Sequence[Camera], pair: MatchedPair) -> PairError:
    """Measure one pair under the given calibration."""
    first, second = cameras[pair.first], cameras[pair.second]
    if np.linalg.norm(first.centre - second.centre) < 1e-9:
        return PairError(
            first=pair.first,
            second=pair.second,
            n_matches=len(pair.uv_first),
            median_px=float("inf"),
            error_px=0.0,
            front_share=0.0,
        )
    errors = epipolar_errors(first, second, pair.uv_first, pair.uv_second)
    depth_first, depth_second, angle_rad = ray_depths(first, second, pair.uv_first, pair.uv_second)
    telling = angle_rad > SMALLEST_ANGLE_RAD
    front = (
        float(((depth_first > 0) & (depth_second > 0))[telling].mean()) if telling.any() else 1.0
    )
    median = float(np.median(errors))
    error = 1.2533 * 1.4826 * float(np.median(np.abs(errors - median))) / np.sqrt(len(errors))
    return PairError(
        first=pair.first,
        second=pair.second,
        n_matches=len(errors),
        median_px=median,
        error_px=error,
        front_share=front,
    )


def is_wrong(cameras: Sequence[Camera], error: PairError) -> bool:
    """Return whether a pair contradicts the calibration."""
    tolerance_px = max(tolerances(cameras[index])[0] for index in (error.first, error.second))
    return (
        error.median_px - SIGMAS * error.error_px > tolerance_px or error.front_share < FRONT_SHARE
    )


def accused(cameras: Sequence[Camera], errors: Sequence[PairError]) -> list[int]:
    """Return the cameras that explain the wrong pairs, the most suspect first.

    The camera with the largest share of wrong pairs is taken out with its pairs, as long as more
    than half of its pairs are wrong: its neighbours, which are wrong only together with it, stay.
    """
    wrong = {error: is_wrong(cameras, error) for error in errors}
    left, suspects = list(errors), []
    while left:
        by_camera: dict[int, list[PairError]] = {}
        for error in left:
            by_camera.setdefault(error.first, []).append(error)
            by_camera.setdefault(error.second, []).append(error)
        shares = {
            index: _wrong_share([error for error in group if wrong[error]], len(group))
            for index, group in by_camera.items()
        }
        camera = max(shares, key=lambda index: (shares[index], -index))
        if shares[camera][0] <= 0.5:
            break
        suspects.append(camera)
        left = [pair for pair in left if camera not in (pair.first, pair.second)]
    return suspects


def camera_error(
    cameras: Sequence[Camera], pairs: Sequence[MatchedPair], index: int, sigmas: float = 0.0
) -> float:
    """Return the error of one camera: the median over its pairs of their median errors, pixels.

    NaN without pairs.

    Args:
        sigmas: standard errors that each median is reduced by: what is certainly wrong.
    """
    medians = []
    for pair in pairs:
        if index in (pair.first, pair.second):
            error = pair_error(cameras, pair)
            medians.append(
                error.median_px - sigmas * error.error_px
                if error.front_share >= FRONT_SHARE
                else float("inf")
            )
    return float(np.median(medians)) if medians else float("nan")


def triangulated_depths(
    cameras: Sequence[Camera], pairs: Sequence[MatchedPair], trusted: Sequence[int]
) -> Mapping[int, Array]:
    """Return the depths of matches in each trusted camera, from pairs of trusted cameras, world
    units.
    """
    depths: dict[int, list[Array]] = {}
    for pair in pairs:
        if pair.first in trusted and pair.second in trusted:
            sound, depth_one, depth_other = sound_matches(
                cameras[pair.first], cameras[pair.second], pair
            )
            depths.setdefault(pair.first, []).append(depth_one[sound])
            depths.setdefault(pair.second, []).append(depth_other[sound])
    return {index: np.concatenate(parts) for index, parts in depths.items()}


def _wrong_share(wrong: Sequence[PairError], n_pairs: int) -> tuple[float, float]:
    """Return the share of a camera's pairs that are wrong, and their mean error for ties."""
    sizes = [min(error.median_px, 1e6) for error in wrong]
    return len(wrong) / n_pairs, float(np.mean(sizes)) if sizes else 0.0
