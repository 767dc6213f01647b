"""Local poses: the camera motion that the matches of one region between two pictures of a path show."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.kernels.portable import transformed

# Of the authors' program.
LAYERS, PNP_ERROR_PX, PNP_ROUNDS, PNP_CONFIDENCE, LEAST_INLIERS = 10, 8.0, 100, 0.99, 0.3
# Ours.
N_POINTS, LEAST_SPACING_PX, LEAST_MATCHES = 5000, 3, 12
LUCAS_KANADE: dict[str, Any] = {
    "winSize": (9, 9),
    "maxLevel": 3,
    "criteria": (3, 30, 0.01),
    "minEigThreshold": 1 / 1024,
}  # 1 level per px
THERE_AND_BACK_PX = 0.5
MATCH_NOISE_PX, UNSURE_DEG = 0.1, 0.05  # a region whose rotation such noise alone would turn by more tells nothing
ONE_SURFACE = 1.03  # of depths around a point, farthest over nearest: beyond it the edge of something is what moves
WINDOWS = (6, 8)  # of the map, rows and columns
AGREED_PX = 1.0  # of the pose that the map is drawn against: one for all must not bend with the part that does


def match_grid(camera: Camera) -> NDArray[np.float32]:
    """Pixels that are matched, column and row, (N, 2)."""
    every = max(LEAST_SPACING_PX, round(float(np.sqrt(camera.width * camera.height / N_POINTS))))
    rows, columns = np.mgrid[every // 2 : camera.height : every, every // 2 : camera.width : every]
    return np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float32)


def lift(camera: Camera, depth: NDArray[np.float32], points: NDArray[np.float32]) -> tuple[Array, NDArray[np.bool_]]:
    """The points in the camera's frame, homogeneous (N, 4), and whether all that is matched around one has its depth."""
    column, row = points.astype(int).T
    z = depth[row, column].astype(np.float64)
    around = np.ones(LUCAS_KANADE["winSize"], np.uint8)
    nearest, farthest = (change(depth, around)[row, column] for change in (cv2.erode, cv2.dilate))
    across = (points + 0.5 - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]] * z[:, None]
    return np.column_stack([across, z, np.ones_like(z)]), (nearest > 0) & (farthest < ONE_SURFACE * nearest)


def project(K: Array, points_3d: Array) -> Array:
    """Pixels as OpenCV counts them, from the centre of the first, (N, 2)."""
    return points_3d[:, :2] / np.maximum(points_3d[:, 2:3], 1e-9) * K[[0, 1], [0, 1]] + K[:2, 2] - 0.5


def find_matches(image: Image8, later: Image8, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Where each point is found again, and whether the way back ends where it began."""
    grey, later_grey = (cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in (image, later))
    found, there, _ = cv2.calcOpticalFlowPyrLK(grey, later_grey, points, None, **LUCAS_KANADE)
    back, again, _ = cv2.calcOpticalFlowPyrLK(later_grey, grey, found, None, **LUCAS_KANADE)
    kept = (there.ravel() > 0) & (again.ravel() > 0) & (np.linalg.norm(back - points, axis=1) < THERE_AND_BACK_PX)
    return found, kept


def depth_layers(depths: NDArray[np.float32]) -> NDArray[np.int64]:
    """Number of the layer of each depth, 0 for the nearest and -1 for unknown: k-means, which begins at quantiles."""
    layers = np.full(len(depths), -1)
    known = depths[depths > 0]
    starts = np.unique(np.quantile(known, (np.arange(LAYERS) + 0.5) / LAYERS)) if known.size else known
    if not starts.size:
        return layers
    labels = np.digitize(known, (starts[1:] + starts[:-1]) / 2).astype(np.int32)
    labels = np.unique(labels, return_inverse=True)[1].astype(np.int32)
    if labels.max():
        rounds = (cv2.TERM_CRITERIA_COUNT, 100, 0.0)
        _, labels, _ = cv2.kmeans(known, int(labels.max()) + 1, labels, rounds, 1, cv2.KMEANS_USE_INITIAL_LABELS)
    layers[depths > 0] = labels.ravel()
    return layers


def local_pose(
    points_3d: Array, found: NDArray[np.float32], K: Array, motion: Array, error_px: float = PNP_ERROR_PX
) -> tuple[Array, Array] | None:
    """Rotation vector and translation of a region, refined from the path's own; None where its matches do not determine them."""
    if len(found) < LEAST_MATCHES:
        return None
    pixels, start = found.astype(np.float64) + 0.5, Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    try:
        solved, _, _, inliers = cv2.solvePnPRansac(
            points_3d[:, :3],
            pixels,
            K,
            None,
            iterationsCount=PNP_ROUNDS,
            reprojectionError=error_px,
            confidence=PNP_CONFIDENCE,
            flags=cv2.SOLVEPNP_ITERATIVE,
        )
    except cv2.error:
        return None
    if not solved or inliers is None or len(inliers) < max(LEAST_MATCHES, LEAST_INLIERS * len(found)):
        return None
    of_pose = inliers.ravel()
    turn, shift = cv2.solvePnPRefineLM(points_3d[of_pose, :3], pixels[of_pose], K, None, start[:, None], motion[:3, 3:].copy())
    slopes = cv2.projectPoints(points_3d[of_pose, :3], turn, shift, K, None)[1][:, :6]
    turn_variance = np.linalg.pinv(slopes.T @ slopes)[:3, :3].trace()
    if np.degrees(MATCH_NOISE_PX * np.sqrt(turn_variance)) > UNSURE_DEG:
        return None
    return turn.ravel(), shift.ravel()


def bends_px(points_3d: Array, found: NDArray[np.float32], start: NDArray[np.float32], camera: Camera, motion: Array) -> Array:
    """Median distance of the matches in each window from the pose of most of all matches; NaN where they are too few."""
    agreed = local_pose(points_3d, found, camera.K, motion, AGREED_PX)
    if agreed is None:
        return np.full(WINDOWS, np.nan)
    moved = transformed(Rotation.from_rotvec(agreed[0]).as_matrix(), points_3d[:, :3]) + agreed[1]
    distances = np.linalg.norm(project(camera.K, moved) - found, axis=1)
    column, row = start.astype(int).T
    window = row * WINDOWS[0] // camera.height * WINDOWS[1] + column * WINDOWS[1] // camera.width
    inside = (distances[window == each] for each in range(WINDOWS[0] * WINDOWS[1]))
    return np.array([np.median(each) if len(each) >= LEAST_MATCHES else np.nan for each in inside]).reshape(WINDOWS)
