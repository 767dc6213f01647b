"""Epipolar geometry of two cameras: features that their images share, how well these agree with it,
and their depths.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera

# Beyond this size SIFT finds the same corners at four times the cost.
LONGEST_SIDE_PX = 1600
MOST_FEATURES = 3000
# Lowe's ratio of nearest to second nearest; repeated patterns fail it.
RATIO = 0.8
# Half of OpenCV's default: small and dim pictures have few strong corners.
CONTRAST = 0.02
# Smoothing before a colour is read, so that a shift of a pixel does not change it.
COLOUR_SIGMA = 2.0
# Matches of one rigid scene agree with some epipolar geometry, regardless of the calibration; fewer
# could agree by chance (it has seven degrees of freedom and is chosen among thousands).
FEWEST_MATCHES = 25
SMALLEST_SHARE = 0.35
# Localisation of SIFT, pixels of the image it was found in.
CONSISTENT_PX = 1.5
# Median error of a pair. Sound calibrations have 0.2 - 0.5 pixels where features are found at full
# size (320 x 240), and at
# 0.4 - 1.1 pixels of 2690, where they are found at a smaller one; a focal length 5 % off gives 1.3
# - 4.4 pixels of 320.
WARN_PX, BAD_PX = 0.8, 1.5
WARN_SHARE, BAD_SHARE = 0.0005, 0.001  # of the longer side, where that is more
# An angle below which the depth of a match is mostly noise.
SMALLEST_ANGLE_RAD = np.radians(1.0)
# Enough that a camera between two faulty neighbours still has honest ones.
NEIGHBOURS = 5


@dataclass(frozen=True, eq=False)
class Features:
    """Keypoints of an image, with the descriptors by which they are recognised.

    Attributes:
        uv: where, pixels of the image (pixel centres at halves), (N, 2).
        descriptors: unit length, float32 (N, 128).
        colours: smoothed RGB around each, 0..255, float32 (N, 3).
    """

    uv: Array
    descriptors: NDArray[np.float32]
    colours: NDArray[np.float32]


def find_features(image: Image8) -> Features:
    """SIFT features of an RGB image, (H, W, 3).

    Their descriptors are square-rooted, for more discriminative distances.
    """
    scale = min(1.0, LONGEST_SIDE_PX / max(image.shape[:2]))
    small = (
        cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if scale < 1
        else image
    )
    sift = cv2.SIFT_create(nfeatures=MOST_FEATURES, contrastThreshold=CONTRAST)  # type: ignore[attr-defined, unused-ignore]
    keypoints, descriptors = sift.detectAndCompute(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), None)
    if not keypoints:
        return Features(
            np.empty((0, 2)), np.empty((0, 128), np.float32), np.empty((0, 3), np.float32)
        )
    # OpenCV counts from the centre of the first pixel
    at = np.array([keypoint.pt for keypoint in keypoints])
    grid = np.array(small.shape[1::-1]) / image.shape[1::-1]
    smooth = cv2.GaussianBlur(small, (0, 0), COLOUR_SIGMA)
    column, row = np.clip(np.rint(at).astype(int), 0, np.array(small.shape[1::-1]) - 1).T
    return Features((at + 0.5) / grid, _root(descriptors), smooth[row, column].astype(np.float32))


def match_features(first: Features, second: Features) -> NDArray[np.int64]:
    """Return the features that are each other's clear nearest, (M, 2) indices into first and
    second.
    """
    if min(len(first.uv), len(second.uv)) < 2:
        return np.empty((0, 2), np.int64)
    likeness = first.descriptors @ second.descriptors.T  # (N, M), cosines
    best = likeness.argmax(axis=1)
    mutual = likeness.argmax(axis=0)[best] == np.arange(len(best))
    rows = np.flatnonzero(mutual)
    nearest = likeness[rows, best[rows]]
    likeness[rows, best[rows]] = -1.0
    clear = np.sqrt(np.maximum(2 - 2 * nearest, 0)) < RATIO * np.sqrt(
        2 - 2 * likeness[rows].max(axis=1)
    )
    return np.stack([rows[clear], best[rows[clear]]], axis=1)


def _root(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)).astype(
        np.float32
    )


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """Points that two cameras both see, without the mismatches that their own geometry reveals.

    Attributes:
        first: index of a camera.
        second: index of another.
        uv_first: pixels, (M, 2).
        uv_second: pixels, (M, 2).
        colours_first: RGB around the points, 0..255, (M, 3).
        colours_second: RGB around the points, 0..255, (M, 3).
    """

    first: int
    second: int
    uv_first: Array
    uv_second: Array
    colours_first: NDArray[np.float32]
    colours_second: NDArray[np.float32]

    def seen_from(self, camera: int) -> tuple[int, Array, Array]:
        """Return the other camera, the points in `camera` and those in the other."""
        if camera == self.first:
            return self.second, self.uv_first, self.uv_second
        return self.first, self.uv_second, self.uv_first


def match_pair(
    first: int,
    second: int,
    features_first: Features,
    features_second: Features,
    longest_side_px: int,
) -> MatchedPair | None:
    """Match two images; None where too few matches agree with each other to say anything.

    Args:
        first: index of the first camera.
        second: index of the second.
        features_first: features of the first image.
        features_second: features of the second.
        longest_side_px: of the images.
    """
    matches = match_features(features_first, features_second)
    if len(matches) < FEWEST_MATCHES:
        return None
    uv_first, uv_second = features_first.uv[matches[:, 0]], features_second.uv[matches[:, 1]]
    mask = consistent(
        uv_first, uv_second, CONSISTENT_PX * max(1.0, longest_side_px / LONGEST_SIDE_PX)
    )
    if mask.sum() < max(FEWEST_MATCHES, SMALLEST_SHARE * len(matches)):
        return None
    rows = matches[mask]
    return MatchedPair(
        first=first,
        second=second,
        uv_first=uv_first[mask],
        uv_second=uv_second[mask],
        colours_first=features_first.colours[rows[:, 0]],
        colours_second=features_second.colours[rows[:, 1]],
    )


def consistent(uv_first: Array, uv_second: Array, tolerance_px: float) -> NDArray[np.bool_]:
    """Return the mask of the matches that agree with the epipolar geometry most of them share,
    without any calibration, (M,).
    """
    try:
        _, inliers = cv2.findFundamentalMat(
            uv_first, uv_second, cv2.USAC_MAGSAC, tolerance_px, 0.9999, 5000
        )
    except cv2.error:  # OpenCV 5 raises where it finds no model at all
        inliers = None
    if inliers is None:
        return np.zeros(len(uv_first), bool)
    return np.asarray(inliers).ravel() > 0


def epipolar_errors(first: Camera, second: Camera, uv_first: Array, uv_second: Array) -> Array:
    """Return the distance of matched points from each other's epipolar lines under a calibration,
    pixels, (M,).

    Root of the mean square of the distances in both images.

    Examples:
        >>> from ggvs_eval.camera import translated_path
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> left, right = translated_path(camera, span=0.25, count=2)
        >>> uv_left, uv_right = (
        ...     np.array([[4.0, 3.0], [4.0, 3.0]]),
        ...     np.array([[3.0, 3.0], [3.0, 4.0]]),
        ... )
        >>> epipolar_errors(left, right, uv_left, uv_right).round(
        ...     6
        ... ).tolist()  # the second match misses its row by a pixel
        [0.0, 1.0]
    """
    points_first, points_second = _homogeneous(uv_first), _homogeneous(uv_second)
    lines_second = points_first @ fundamental_matrix(first, second).T  # (M, 3), in the other image
    lines_first = points_second @ fundamental_matrix(first, second)
    residual = np.einsum("mi,mi->m", points_second, lines_second)
    squared_first, squared_second = (
        np.maximum((lines[:, :2] ** 2).sum(axis=1), 1e-30) for lines in (lines_first, lines_second)
    )
    return np.asarray(np.abs(residual) * np.sqrt((1 / squared_first + 1 / squared_second) / 2))


def fundamental_matrix(first: Camera, second: Camera) -> Array:
    """F with second^T F first = 0 for the homogeneous pixels of a point in both images, (3, 3)."""
    rotation = second.rotation @ first.rotation.T
    shift = second.translation - rotation @ first.translation
    across = np.array(
        [[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]]
    )
    return np.asarray(np.linalg.inv(second.K).T @ across @ rotation @ np.linalg.inv(first.K))


def ray_depths(
    first: Camera, second: Camera, uv_first: Array, uv_second: Array
) -> tuple[Array, Array, Array]:
    """Triangulate matched points: find the depths where their rays pass nearest to each other.

    Returns:
        Depth in the first camera, depth in the other, world units, (M,) each, negative behind a
        camera, and the angle between the rays, radians, (M,).
    """
    unit_depths = np.ones(len(uv_first))
    rays_first = first.unproject(uv_first, unit_depths) - first.centre
    rays_second = second.unproject(uv_second, unit_depths) - second.centre
    baseline = second.centre - first.centre
    a, b, c = (
        (p * q).sum(axis=1)
        for p, q in (
            (rays_first, rays_first),
            (rays_first, rays_second),
            (rays_second, rays_second),
        )
    )
    d, e = rays_first @ baseline, rays_second @ baseline
    determinant = np.maximum(a * c - b * b, 1e-12 * a * c)
    angle_rad = np.arcsin(np.sqrt(np.clip(determinant / (a * c), 0, 1)))
    return (c * d - b * e) / determinant, (b * d - a * e) / determinant, angle_rad


def tolerances(camera: Camera) -> tuple[float, float]:
    """Return the median epipolar error above which a camera is looked at, and above which it is
    bad, pixels.
    """
    longest = max(camera.size)
    return max(WARN_PX, WARN_SHARE * longest), max(BAD_PX, BAD_SHARE * longest)


def sound_matches(
    first: Camera, second: Camera, pair: MatchedPair
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Mask of matches with a depth under a calibration: near their epipolar lines, in front of
    both, at a sufficient angle.

    Returns:
        (M,), and the depth of all matches in the first camera and in the other, world units, (M,)
        each.
    """
    sound = epipolar_errors(first, second, pair.uv_first, pair.uv_second) < tolerances(first)[1]
    depth_first, depth_second, angle_rad = ray_depths(first, second, pair.uv_first, pair.uv_second)
    return (
        sound & (depth_first > 0) & (depth_second > 0) & (angle_rad > SMALLEST_ANGLE_RAD),
        depth_first,
        depth_second,
    )


def neighbour_pairs(cameras: Sequence[Camera], count: int = NEIGHBOURS) -> list[tuple[int, int]]:
    """Pair every camera with its `count` nearest, each pair once, smaller index first.

    Near means near in place and in viewing direction: cameras back to back are close and share
    nothing.
    """
    pairs = set()
    for index, camera in enumerate(cameras):
        order = sorted(
            (remoteness(camera, neighbour), place)
            for place, neighbour in enumerate(cameras)
            if place != index
        )
        pairs |= {(min(index, place), max(index, place)) for _, place in order[:count]}
    return sorted(pairs)


def remoteness(camera: Camera, partner: Camera) -> float:
    """Return the distance of the centres, doubled at 90 degrees between the axes and tripled back
    to back.
    """
    distance = float(np.linalg.norm(camera.centre - partner.centre))
    return distance * (2.0 - float(camera.axis @ partner.axis))


def _homogeneous(uv: Array) -> Array:
    return np.concatenate([uv, np.ones((len(uv), 1))], axis=1)
