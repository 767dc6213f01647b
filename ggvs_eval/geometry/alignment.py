"""Alignment of one calibration to another: the similarity that fits camera centres best."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.errors import CameraError


@dataclass(frozen=True, eq=False)
class Similarity:
    """The map x -> scale * rotation @ x + translation.

    Attributes:
        scale: positive.
        rotation: (3, 3), determinant +1.
        translation: (3,), in units of the target.
    """

    scale: float
    rotation: Array
    translation: Array

    def apply(self, points: Array) -> Array:
        """Move points, (..., 3)."""
        return self.scale * points @ self.rotation.T + self.translation


def align_similarity(source: Array, target: Array) -> Similarity:
    """Return the similarity that takes source points to target points with the least sum of squared
    distances.

    Closed form of Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", 1991: rotation from the singular vectors of the covariance with the last one turned
    where that would mirror (eq. 39, 40), scale from its singular values (eq. 42), translation from
    the means (eq. 41).

    Args:
        source: (N, 3), at least 3 points not all on one line.
        target: (N, 3), the point that each should meet.

    Raises:
        CameraError: too few points, or points on a line, which leave a rotation around it open.

    Examples:
        >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> found = align_similarity(points, 2 * points + (0, 0, 5))
        >>> round(found.scale, 6), bool(np.allclose(found.apply(points), 2 * points + (0, 0, 5)))
        (2.0, True)
    """
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    covariance = (target - target_mean).T @ (source - source_mean) / len(source)  # (3, 3)
    left, singular, right = np.linalg.svd(covariance)
    if len(source) < 3 or singular[1] <= 1e-9 * singular[0]:
        raise CameraError(
            f"alignment: wanted 3 or more camera centres off a line, got {len(source)}; compare "
            f"more cameras"
        )
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = left @ np.diag(signs) @ right
    scale = float((singular * signs).sum() / np.square(source - source_mean).sum(axis=1).mean())
    return Similarity(scale, rotation, target_mean - scale * rotation @ source_mean)


def pose_differences(
    estimated: Mapping[str, Camera], reference: Mapping[str, Camera]
) -> tuple[Array, Array]:
    """Measure the pose errors of estimated cameras against reference ones, after aligning the
    centres by a similarity.

    Args:
        estimated: cameras by name, in any world.
        reference: cameras by name; those that are in both are compared, in the order of
            `estimated`.

    Returns:
        Distances of centres in units of `reference` (N,), and angles between orientations in
        radians (N,).

    Raises:
        CameraError: fewer than 3 common cameras, or all on a line.
    """
    names = [name for name in estimated if name in reference]
    if len(names) < 3:
        raise CameraError(
            f"alignment: wanted 3 or more common cameras, got {', '.join(names) or 'none'}; "
            f"compare the same rig"
        )
    similarity = align_similarity(
        np.array([estimated[name].centre for name in names]),
        np.array([reference[name].centre for name in names]),
    )
    centres = similarity.apply(np.array([estimated[name].centre for name in names]))
    distances = np.linalg.norm(centres - [reference[name].centre for name in names], axis=1)
    turns = [
        reference[name].rotation @ similarity.rotation @ estimated[name].rotation.T
        for name in names
    ]
    return distances, np.array([_angle_rad(turn) for turn in turns])


def _angle_rad(rotation: Array) -> float:
    """Return the angle of a rotation.

    From the skew part too, since the cosine alone says nothing below 1e-8.
    """
    skew = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    return float(np.arctan2(np.linalg.norm(skew) / 2, (np.trace(rotation) - 1) / 2))
