"""Features of one image, and which of them two images share."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8

# Beyond this size SIFT finds the same corners at four times the cost.
LONGEST_SIDE_PX = 1600
MOST_FEATURES = 3000
# Lowe's ratio of nearest to second nearest; repeated patterns fail it.
RATIO = 0.8
# Half of OpenCV's default: small and dim pictures have few strong corners.
CONTRAST = 0.02
# Smoothing before a colour is read, so that a shift of a pixel does not change it.
COLOUR_SIGMA = 2.0


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
    """SIFT features of an RGB image, (H, W, 3); their descriptors are square-rooted, which makes distances more telling."""
    scale = min(1.0, LONGEST_SIDE_PX / max(image.shape[:2]))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
    sift = cv2.SIFT_create(nfeatures=MOST_FEATURES, contrastThreshold=CONTRAST)  # type: ignore[attr-defined, unused-ignore]
    keypoints, descriptors = sift.detectAndCompute(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), None)
    if not keypoints:
        return Features(np.empty((0, 2)), np.empty((0, 128), np.float32), np.empty((0, 3), np.float32))
    at = np.array([keypoint.pt for keypoint in keypoints])  # OpenCV counts from the centre of the first pixel
    grid = np.array(small.shape[1::-1]) / image.shape[1::-1]
    smooth = cv2.GaussianBlur(small, (0, 0), COLOUR_SIGMA)
    column, row = np.clip(np.rint(at).astype(int), 0, np.array(small.shape[1::-1]) - 1).T
    return Features((at + 0.5) / grid, _root(descriptors), smooth[row, column].astype(np.float32))


def match_features(first: Features, second: Features) -> NDArray[np.int64]:
    """Features that are each other's clear nearest, (M, 2) indices into first and second."""
    if min(len(first.uv), len(second.uv)) < 2:
        return np.empty((0, 2), np.int64)
    likeness = first.descriptors @ second.descriptors.T  # (N, M), cosines
    best = likeness.argmax(axis=1)
    mutual = likeness.argmax(axis=0)[best] == np.arange(len(best))
    rows = np.flatnonzero(mutual)
    nearest = likeness[rows, best[rows]]
    likeness[rows, best[rows]] = -1.0
    clear = np.sqrt(np.maximum(2 - 2 * nearest, 0)) < RATIO * np.sqrt(2 - 2 * likeness[rows].max(axis=1))
    return np.stack([rows[clear], best[rows[clear]]], axis=1)


def _root(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)).astype(np.float32)
