"""Bundle adjustment with a prior: poses and lenses that are nearly right, brought to where the
features are.

COLMAP's own adjustment knows nothing of what is likely. In small rigs a lens then trades focal
length and principal point for a turn of the camera: lenses of two rows of four cameras, known
exactly, ended 12 % off. Here every camera stays near what is known of it unless its features say
otherwise. Runs in the process of `calibration_worker` alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, diags_array, eye_array, hstack, vstack
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from ggvs_eval.arrays import Array

# Standard deviations of the prior: turns about each axis, centres as a share of the rig's extent,
# focal lengths of themselves, principal points of the longer side; and of the features, beyond
# which they count as outliers do, linearly.
TURN_RAD, CENTRE_SHARE, FOCAL_SHARE, PRINCIPAL_POINT_SHARE = np.radians(0.2), 0.003, 0.005, 0.003
FEATURE_PX = 0.5
FREEDOMS = 9  # of a camera: turn, centre, focal length, principal point
MOST_STEPS, LEAST_GAIN = 30, 1e-6
DIFFERENCE = 1e-5  # of a prior's standard deviation, for derivatives


@dataclass(frozen=True, eq=False)
class Rig:
    """Known cameras and their features.

    Attributes:
        turns: worlds to cameras, (C, 3, 3).
        centres: world units, (C, 3).
        deviations: of each camera's freedoms, (C, 9): radians, world units, a factor, pixels.
        camera: of each feature, ascending, (M,).
        point: of each feature, (M,).
        uv: of each feature, pixels, (M, 2).
    """

    lenses: tuple[Any, ...]
    turns: Array
    centres: Array
    deviations: Array
    camera: NDArray[np.int64]
    point: NDArray[np.int64]
    uv: Array

    def moved(self, changes: Array) -> tuple[Array, Array]:
        """Turns (C, 3, 3) and centres (C, 3) after changes (C, 9) in standard deviations."""
        steps = changes * self.deviations
        return Rotation.from_rotvec(steps[:, :3]).as_matrix() @ self.turns, self.centres + steps[
            :, 3:6
        ]

    def project(self, changes: Array, points: Array) -> Array:
        """Expected places of the features, (M, 2), pixels."""
        turns, centres = self.moved(changes)
        points_camera = np.einsum(
            "mij,mj->mi", turns[self.camera], points[self.point] - centres[self.camera]
        )
        uv = np.empty_like(self.uv)
        for number, lens in enumerate(self.lenses):
            rows = slice(*np.searchsorted(self.camera, (number, number + 1)))
            zoom, shift = (
                1 + changes[number, 6] * self.deviations[number, 6],
                changes[number, 7:] * self.deviations[number, 7:],
            )
            middle = np.array([lens.principal_point_x, lens.principal_point_y])
            uv[rows] = zoom * (lens.img_from_cam(points_camera[rows]) - middle) + middle + shift
        return uv


def refined_views(model: Any, views: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the known cameras, moved to where the features of a model are most likely.

    Args:
        model: a reconstruction with points, in the world of the views; its own cameras may have
            been refined already.
        views: image -> ``model``, ``params``, ``width``, ``height`` and ``world_to_camera``, as
            `calibration_worker.run_job` has them; those of images without points come back as they
            are.

    Reading:
        A maximum a posteriori estimate: Gauss-Newton steps damped after Levenberg and Marquardt
        (Triggs et al., "Bundle adjustment - a modern synthesis", 2000), features weighed by the
        pseudo-Huber loss. The prior fixes the world, its scale included.
    """
    images = [
        image
        for image in sorted(model.images.values(), key=lambda image: image.name)
        if image.num_points3D > 0
    ]
    if len(images) < 2:
        return {name: dict(view) for name, view in views.items()}
    rig, points = _rig(model, images, [views[image.name] for image in images])
    changes, _ = most_likely(rig, points)
    turns, centres = rig.moved(changes)
    refined = {name: dict(view) for name, view in views.items()}
    for image, turn, centre, steps in zip(
        images, turns, centres, changes * rig.deviations, strict=True
    ):
        view = refined[image.name]
        fx, fy, cx, cy, *distortion = view["params"]
        zoom = 1 + steps[6]
        view["params"] = [
            float(value)
            for value in (fx * zoom, fy * zoom, cx + steps[7], cy + steps[8], *distortion)
        ]
        view["world_to_camera"] = np.column_stack([turn, -turn @ centre]).tolist()
    return refined


def _rig(model: Any, images: list[Any], views: list[Mapping[str, Any]]) -> tuple[Rig, Array]:
    """Return the rig of some images, and the points that they see, (P, 3)."""
    import pycolmap

    numbers = {identity: number for number, identity in enumerate(sorted(model.points3D))}
    camera, point, uv = [], [], []
    for number, image in enumerate(images):
        features = [feature for feature in image.points2D if feature.has_point3D()]
        camera += [number] * len(features)
        point += [numbers[feature.point3D_id] for feature in features]
        uv += [feature.xy for feature in features]
    poses = np.array([view["world_to_camera"] for view in views])
    turns = poses[:, :, :3]
    centres = -np.einsum("nji,nj->ni", turns, poses[:, :, 3])
    extent = float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).max())
    deviations = [
        [TURN_RAD] * 3
        + [CENTRE_SHARE * extent] * 3
        + [FOCAL_SHARE]
        + [PRINCIPAL_POINT_SHARE * max(view["width"], view["height"])] * 2
        for view in views
    ]
    lenses = tuple(
        pycolmap.Camera(**{key: view[key] for key in ("model", "width", "height", "params")})
        for view in views
    )
    rig = Rig(
        lenses=lenses,
        turns=turns,
        centres=centres,
        deviations=np.array(deviations),
        camera=np.array(camera),
        point=np.array(point),
        uv=np.array(uv),
    )
    return rig, np.array([model.points3D[identity].xyz for identity in sorted(model.points3D)])


def most_likely(rig: Rig, points: Array) -> tuple[Array, Array]:
    """Changes of the cameras (C, 9) in standard deviations, and the points (P, 3), from a first
    guess of these.
    """
    changes, damping = np.zeros((len(rig.lenses), FREEDOMS)), 1e-3
    least = cost(rig, changes, points)
    for _ in range(MOST_STEPS):
        step, shift = _step(rig, changes, points, damping)
        tried = cost(rig, changes + step, points + shift)
        if not tried < least:
            damping *= 10
            continue
        gain, least, damping = 1 - tried / least, tried, damping / 10
        changes, points = changes + step, points + shift
        if gain < LEAST_GAIN:
            break
    return changes, points


def cost(rig: Rig, changes: Array, points: Array) -> float:
    """Minus the logarithm of the likelihood, up to a constant: pseudo-Huber loss of the features
    and the prior.
    """
    errors = (rig.project(changes, points) - rig.uv) / FEATURE_PX
    return float(
        (np.sqrt(1 + np.square(errors).sum(axis=1)) - 1).sum() + 0.5 * np.square(changes).sum()
    )


def _step(rig: Rig, changes: Array, points: Array, damping: float) -> tuple[Array, Array]:
    """Return the step of the cameras (C, 9) and of the points (P, 3)."""
    uv = rig.project(changes, points)
    errors = (uv - rig.uv) / FEATURE_PX
    weights = (1 + np.square(errors).sum(axis=1)) ** -0.25  # square roots of the loss's weights
    by_camera = np.stack(
        [rig.project(changes + DIFFERENCE * unit, points) - uv for unit in np.eye(FREEDOMS)],
        axis=-1,
    )
    small = DIFFERENCE * float(np.ptp(points, axis=0).max())
    by_point = np.stack(
        [rig.project(changes, points + small * unit) - uv for unit in np.eye(3)], axis=-1
    )
    scale = weights[:, None, None] / FEATURE_PX
    of_cameras = _jacobian(by_camera * scale / DIFFERENCE, rig.camera, len(changes))
    of_points = _jacobian(by_point * scale / small, rig.point, len(points))
    prior = eye_array(changes.size, changes.size + points.size)
    jacobian = vstack([hstack([of_cameras, of_points]), prior], format="csc")
    residuals = np.concatenate([(errors * weights[:, None]).ravel(), changes.ravel()])
    normal = (jacobian.T @ jacobian).tocsc()
    damped = normal + diags_array(damping * normal.diagonal() + 1e-12, format="csc")
    step = splu(damped, "MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(
        -(jacobian.T @ residuals)
    )
    return step[: changes.size].reshape(changes.shape), step[changes.size :].reshape(points.shape)


def _jacobian(blocks: Array, columns: NDArray[np.int64], count: int) -> Any:
    """Return the derivatives of all features, (2 M, count * n), of blocks (M, 2, n)."""
    shape = 2 * len(blocks), count * blocks.shape[2]
    return bsr_array((blocks, columns, np.arange(len(blocks) + 1)), shape=shape)
