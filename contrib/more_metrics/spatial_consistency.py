"""Spatial geometric consistency (SGC) of a rendered path: whether all parts of a picture moved by
one and the same camera.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import to_8_bit
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.kernels.portable import transformed
from ggvs_eval.metrics.inputs import Image
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.rendered_path import (
    PathMetric,
    PathScorer,
    Pose,
    RenderedPath,
    checked_depth,
    whole_path,
)
from ggvs_eval.metrics.path.view_consistency import PATH_SHARPNESS

# Of the authors' program.
LAYERS, PNP_ERROR_PX, PNP_ROUNDS, PNP_CONFIDENCE, LEAST_INLIERS = 10, 8.0, 100, 0.99, 0.3
# Chosen here.
N_POINTS, LEAST_SPACING_PX, LEAST_MATCHES = 5000, 3, 12
LUCAS_KANADE: dict[str, Any] = {
    "winSize": (9, 9),
    "maxLevel": 3,
    "criteria": (3, 30, 0.01),
    "minEigThreshold": 1 / 1024,
}  # 1 level per px
THERE_AND_BACK_PX = 0.5
# a region whose rotation such noise alone would turn by more is ignored
MATCH_NOISE_PX, UNSURE_DEG = 0.1, 0.05
# of depths around a point, farthest over nearest: beyond it the edge of something is what moves
ONE_SURFACE = 1.03
WINDOWS = (6, 8)  # of the map, rows and columns
# of the pose that the map is drawn against: one for all must not bend with the part that does
AGREED_PX = 1.0


def match_grid(camera: Camera) -> NDArray[np.float32]:
    """Return the pixels that are matched, column and row, (N, 2)."""
    every = max(LEAST_SPACING_PX, round(float(np.sqrt(camera.width * camera.height / N_POINTS))))
    rows, columns = np.mgrid[every // 2 : camera.height : every, every // 2 : camera.width : every]
    return np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float32)


def lift(
    camera: Camera, depth: NDArray[np.float32], points: NDArray[np.float32]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the points in the camera's frame, homogeneous (N, 4), and whether all that is matched
    around one has its depth.
    """
    column, row = points.astype(int).T
    z = depth[row, column].astype(np.float64)
    around = np.ones(LUCAS_KANADE["winSize"], np.uint8)
    nearest, farthest = (change(depth, around)[row, column] for change in (cv2.erode, cv2.dilate))
    across = (points + 0.5 - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]] * z[:, None]
    return np.column_stack([across, z, np.ones_like(z)]), (nearest > 0) & (
        farthest < ONE_SURFACE * nearest
    )


def project(K: Array, points_3d: Array) -> Array:
    """Return the pixels as OpenCV counts them, from the centre of the first, (N, 2)."""
    return (
        points_3d[:, :2] / np.maximum(points_3d[:, 2:3], 1e-9) * K[[0, 1], [0, 1]] + K[:2, 2] - 0.5
    )


def find_matches(
    image: Image8, later: Image8, points: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Match each point, with a forward-backward check."""
    grey, later_grey = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (image, later))
    matches, status, _ = cv2.calcOpticalFlowPyrLK(grey, later_grey, points, None, **LUCAS_KANADE)
    back, again, _ = cv2.calcOpticalFlowPyrLK(later_grey, grey, matches, None, **LUCAS_KANADE)
    is_match = (
        (status.ravel() > 0)
        & (again.ravel() > 0)
        & (np.linalg.norm(back - points, axis=1) < THERE_AND_BACK_PX)
    )
    return matches, is_match


def depth_layers(depths: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the number of the layer of each depth, 0 for the nearest and -1 for unknown: k-means,
    which begins at quantiles.
    """
    layers = np.full(len(depths), -1)
    depths_known = depths[depths > 0]
    starts = (
        np.unique(np.quantile(depths_known, (np.arange(LAYERS) + 0.5) / LAYERS))
        if depths_known.size
        else depths_known
    )
    if not starts.size:
        return layers
    labels = np.digitize(depths_known, (starts[1:] + starts[:-1]) / 2).astype(np.int32)
    labels = np.unique(labels, return_inverse=True)[1].astype(np.int32)
    if labels.max():
        rounds = (cv2.TERM_CRITERIA_COUNT, 100, 0.0)
        _, labels, _ = cv2.kmeans(
            depths_known, int(labels.max()) + 1, labels, rounds, 1, cv2.KMEANS_USE_INITIAL_LABELS
        )
    layers[depths > 0] = labels.ravel()
    return layers


def local_pose(
    points_3d: Array,
    matches: NDArray[np.float32],
    K: Array,
    motion: Array,
    error_px: float = PNP_ERROR_PX,
) -> tuple[Array, Array] | None:
    """Rotation vector and translation of a region, refined from the path's own.

    None if its matches do not determine them.
    """
    if len(matches) < LEAST_MATCHES:
        return None
    pixels, start = (
        matches.astype(np.float64) + 0.5,
        Rotation.from_matrix(motion[:3, :3]).as_rotvec(),
    )
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
    if (
        not solved
        or inliers is None
        or len(inliers) < max(LEAST_MATCHES, LEAST_INLIERS * len(matches))
    ):
        return None
    of_pose = inliers.ravel()
    turn, shift = cv2.solvePnPRefineLM(
        points_3d[of_pose, :3], pixels[of_pose], K, None, start[:, None], motion[:3, 3:].copy()
    )
    slopes = cv2.projectPoints(points_3d[of_pose, :3], turn, shift, K, None)[1][:, :6]
    turn_variance = np.linalg.pinv(slopes.T @ slopes)[:3, :3].trace()
    if np.degrees(MATCH_NOISE_PX * np.sqrt(turn_variance)) > UNSURE_DEG:
        return None
    return turn.ravel(), shift.ravel()


def bends_px(
    points_3d: Array,
    matches: NDArray[np.float32],
    start: NDArray[np.float32],
    camera: Camera,
    motion: Array,
) -> Array:
    """Median distance of the matches in each window from the pose of most of all matches.

    NaN if they are too few.
    """
    agreed = local_pose(points_3d, matches, camera.K, motion, AGREED_PX)
    if agreed is None:
        return np.full(WINDOWS, np.nan)
    moved = transformed(Rotation.from_rotvec(agreed[0]).as_matrix(), points_3d[:, :3]) + agreed[1]
    distances = np.linalg.norm(project(camera.K, moved) - matches, axis=1)
    column, row = start.astype(int).T
    window = row * WINDOWS[0] // camera.height * WINDOWS[1] + column * WINDOWS[1] // camera.width
    inside = (distances[window == number] for number in range(WINDOWS[0] * WINDOWS[1]))
    return np.array(
        [np.median(group) if len(group) >= LEAST_MATCHES else np.nan for group in inside]
    ).reshape(WINDOWS)


NAMES = ("SGC_rotation", "SGC_translation", "SGC_measured")
LEAST_SHIFT_PX = 4.0  # of the poses compared: matches are good to about 0.1 px
STILL = 0.25  # of the shift that the poses ask for: images that move less are static
Look = Callable[[int], tuple[Image, NDArray[np.float32] | None]]


@dataclass(frozen=True, eq=False)
class SpatialConsistency:
    """Disagreement of the camera motions that the regions of a picture show, mean over the steps of
    a path; lower is better.

    Attributes:
        rotation: variance of the regions' rotations about their mean, degrees squared.
        translation: of their translations, in squares of the step that the cameras take; None where
            these only turn.
        measured_share: share of the steps at which there were two regions to compare.
        bend_px: where: median distance of the matches in each window of the picture from where the
            pose that most regions agree on puts them, pixels, (6, 8); NaN without matches.
        stride: how many poses on each is compared with.
        steps: (first pose, rotation, translation) of those that were measured.
    """

    rotation: float
    translation: float | None
    measured_share: float
    bend_px: Array
    stride: int
    steps: tuple[tuple[int, float, float | None], ...]


@dataclass(frozen=True, eq=False)
class _Step:
    rotation: float
    translation: float | None
    bend_px: Array


def spatial_consistency(poses: Sequence[Pose]) -> SpatialConsistency:
    """Measure the local pose consistency of SGC (Dou et al., arXiv 2603.19048; their
    sgc/calculate_glo_fast.py).

    Args:
        poses: camera, image (H, W, 3) uint8 in 0..255 or float in [0, 1], and depth (H, W) float32,
            world units, 0 = unknown; in order. Where the scene itself moves, set the depth to 0:
            SGC is of static regions, and it has no vote.

    Raises:
        MetricError: fewer than two poses, no depth, cameras that do not move the picture, images
            that are static though the cameras move, or no step with two regions that have matches:
            there is nothing to compare, which is not consistency.

    Example:
        >>> spatial_consistency([])
        Traceback (most recent call last):
        ...
        ggvs_eval.errors.MetricError: SGC compares poses: wanted at least 2 on the path, got 0; add poses

    Reading:
        As the authors' program (github.com/tj12323/SGC): the later picture is cut into 10 layers by
        k-means over its depth; in each a pose is found by PnP (RANSAC, 100 rounds, 8 px, 30 %
        inliers) from the earlier picture's points in space and their matches; the mean of squared
        angles to the mean rotation vector, and of squared distances to the mean translation. Chosen
        here: matches are Lucas-Kanade's there and back, not a network's; depth is given, one for
        all methods, not predicted; a step reaches so many poses on that the cameras move the
        picture by 4 px, for all methods alike. PnP's pose is refined from the path's, since flat
        regions have two. A region wants, not 4 matches, but 12 on texture (1 level per px) inside
        one surface that determine its rotation to 0.05 degrees; one region alone is no value, not
        0. Translations count in steps of the path, since their units are arbitrary; no motion is
        segmented, see `poses`. Their score SGC joins these numbers with the same against a
        network's poses and a depth error, by weights fitted to that network's units; it has no
        meaning here. The map is chosen here.
    """  # noqa: E501
    return _measured([pose[0] for pose in poses], lambda index: poses[index][1:])


def _measured(cameras: Sequence[Camera], look: Look) -> SpatialConsistency:
    if len(cameras) < 2:
        raise MetricError(
            f"SGC compares poses: wanted at least 2 on the path, got {len(cameras)}; add poses"
        )
    points = match_grid(cameras[0])
    stride = _stride(cameras, look, points)
    outcomes = {
        index: _step(cameras, look, points, index, index + stride)
        for index in range(len(cameras) - stride)
    }
    steps = {index: step for index, step in outcomes.items() if isinstance(step, _Step)}
    if not steps:
        reasons = [reason for reason in outcomes.values() if isinstance(reason, str)]
        most = max(sorted(set(reasons)), key=reasons.count)
        raise MetricError(
            f"SGC: none of {len(outcomes)} steps can be measured: at {reasons.count(most)} {most}"
        )
    translations = [step.translation for step in steps.values() if step.translation is not None]
    bends = np.array([step.bend_px for step in steps.values()])
    is_known = np.isfinite(bends)
    return SpatialConsistency(
        rotation=float(np.mean([step.rotation for step in steps.values()])),
        translation=float(np.mean(translations)) if translations else None,
        measured_share=len(steps) / len(outcomes),
        bend_px=np.where(
            is_known.any(axis=0),
            np.where(is_known, bends, 0).sum(axis=0) / np.maximum(is_known.sum(axis=0), 1),
            np.nan,
        ),
        stride=stride,
        steps=tuple((index, step.rotation, step.translation) for index, step in steps.items()),
    )


def _stride(cameras: Sequence[Camera], look: Look, points: NDArray[np.float32]) -> int:
    """Return the number of poses after which the image moves by `LEAST_SHIFT_PX`, from five poses
    of the path.
    """
    sampled = np.unique(np.linspace(0, len(cameras) - 1, 5).round().astype(int)).tolist()
    lifted = {
        index: lift(cameras[index], checked_depth(cameras[index], look(index)[1]), points)
        for index in sampled
    }

    def shift_px(stride: int) -> float:
        shifts = []
        for index, (points_3d, mask) in lifted.items():
            partner = index + stride if index + stride < len(cameras) else index - stride
            if partner >= 0 and mask.any():
                moved = transformed(
                    rigid_between(cameras[index], cameras[partner]), points_3d[mask]
                )
                shifts.append(
                    np.median(
                        np.linalg.norm(project(cameras[partner].K, moved) - points[mask], axis=1)
                    )
                )
        return float(np.median(shifts)) if shifts else 0.0

    if not any(mask.any() for _, mask in lifted.values()):
        raise MetricError(
            "SGC: the path has no known depth; prepare a run with depth, or give each pose its "
            "depth"
        )
    shifts = {stride: shift_px(stride) for stride in range(1, len(cameras))}
    enough = [stride for stride, shift in shifts.items() if shift >= LEAST_SHIFT_PX]
    if not enough:
        raise MetricError(
            "SGC: the path has no parallax: its cameras move the picture by at most "
            f"{max(shifts.values()):.2g} px, wanted {LEAST_SHIFT_PX:g}; use a longer path or "
            "larger images"
        )
    return enough[0]


def _step(
    cameras: Sequence[Camera], look: Look, points: NDArray[np.float32], first: int, second: int
) -> _Step | str:
    """Compare the regions' poses of one step; the reason where there are not two."""
    before, after = cameras[first], cameras[second]
    (image, depth), (later_image, later_depth) = look(first), look(second)
    depth, later_depth = checked_depth(before, depth), checked_depth(after, later_depth)
    matches, mask = find_matches(to_8_bit(image), to_8_bit(later_image), points)
    points_3d, is_known = lift(before, depth, points)
    column, row = np.rint(matches).astype(int).T
    mask &= is_known & (column >= 0) & (column < after.width) & (row >= 0) & (row < after.height)
    points_3d, matches, start, column, row = (
        points_3d[mask],
        matches[mask],
        points[mask],
        column[mask],
        row[mask],
    )
    if not mask.any():
        return "no point with a depth is matched"
    motion = rigid_between(before, after)
    expected_px = np.median(
        np.linalg.norm(project(after.K, transformed(motion, points_3d)) - start, axis=1)
    )
    if np.median(np.linalg.norm(matches - start, axis=1)) < STILL * expected_px:
        return f"the images are static while the cameras move them by {expected_px:.1f} px"
    layers = depth_layers(later_depth[row, column])
    poses = [
        pose
        for layer in range(layers.max() + 1)
        if (
            pose := local_pose(
                points_3d[layers == layer], matches[layers == layer], after.K, motion
            )
        )
        is not None
    ]
    if len(poses) < 2:
        return (
            f"{len(poses)} of {layers.max() + 1} layers of depth have matches that determine a "
            f"pose, wanted 2"
        )
    turns, shifts = (np.array([pose[part] for pose in poses]) for part in (0, 1))
    angles = (
        Rotation.from_rotvec(turns) * Rotation.from_rotvec(turns.mean(axis=0)).inv()
    ).magnitude()
    step = float(np.linalg.norm(motion[:3, 3]))
    return _Step(
        rotation=float(np.square(np.degrees(angles)).mean()),
        translation=float(np.square(shifts - shifts.mean(axis=0)).sum(axis=1).mean()) / step**2
        if step
        else None,
        bend_px=bends_px(points_3d, matches, start, after, motion),
    )


def _measure(path: RenderedPath) -> list[Value]:
    """Return the variances of every step, at its first pose, and of the whole path."""
    consistency = _measured(path.cameras, path.look)
    rotation, translation, share = NAMES
    values: list[Value] = [(rotation, pose, value) for pose, value, _ in consistency.steps]
    values += [
        (translation, pose, value) for pose, _, value in consistency.steps if value is not None
    ]
    values += whole_path((rotation, share), consistency.rotation, consistency.measured_share)
    return (
        values
        if consistency.translation is None
        else [*values, *whole_path((translation,), consistency.translation)]
    )


_SCORER = PathScorer(
    NAMES,
    _measure,
    "the cameras of the path only turn: no translations to compare",
    wants_images=True,
)
_REFERENCE = "local poses of SGC, arXiv 2603.19048; docs/metrics.md"
SGC_ROTATION = PathMetric(
    name="SGC_rotation",
    function=spatial_consistency,
    unit="°²",
    higher_is_better=False,
    decimals=4,
    describe="variance of the rotations of image layers between poses: differences are geometric "
    "inconsistency",
    reference=_REFERENCE,
    scorer=_SCORER,
    beside=PATH_SHARPNESS.name,
)
SGC_TRANSLATION = PathMetric(
    name="SGC_translation",
    function=spatial_consistency,
    unit="steps²",
    higher_is_better=False,
    decimals=4,
    describe="the same of the translations, in squares of the step that the cameras take",
    reference=_REFERENCE,
    scorer=_SCORER,
    beside=PATH_SHARPNESS.name,
)
