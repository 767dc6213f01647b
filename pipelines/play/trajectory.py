"""A closed, smooth way of a virtual camera between the cameras of a rig."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.errors import CameraError

REACH = 0.6  # of the rig's extent along its two main directions


def camera_loop(cameras: Sequence[Camera], count: int, width: int | None = None) -> list[Camera]:
    """Poses once around the middle of a rig, evenly spaced in phase; the last is followed by the first.

    Each pose is a mean of the cameras around a point that runs along an ellipse in the rig's two main directions, weighted by a
    Gaussian of their distance from it, so that it stands between cameras and looks where they look, be they in rows, on an arc,
    on a dome or carried by hand.

    Args:
        cameras: the rig, at least two.
        count: number of poses, called ``pose0000``, ...
        width: of the view in pixels, made even, as videos want it; the size of the middle camera when None.

    Raises:
        CameraError: fewer than two cameras or no pose, or a view without pixels.
    """
    if len(cameras) < 2 or count < 1:
        raise CameraError(f"camera loop: wanted at least 2 cameras and 1 pose, got {len(cameras)} and {count}")
    centres = np.stack([camera.centre for camera in cameras])  # (N, 3)
    rotations = Rotation.from_matrix(np.stack([camera.rotation for camera in cameras]))
    places = _places(centres)  # (N, 2)
    view = _view(cameras, centres, width)
    poses = []
    for index, weights in enumerate(_weights(places, count)):
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = rotations.mean(weights).as_matrix()
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ (weights @ centres)
        poses.append(replace(view, name=f"pose{index:04d}", world_to_camera=world_to_camera))
    return poses


def _places(centres: Array) -> Array:
    """The cameras' places along the two directions in which the rig is widest, from the middle of its extent, (N, 2)."""
    offsets = centres - centres.mean(axis=0)
    directions = np.linalg.svd(offsets, full_matrices=False)[2][:2]
    places = offsets @ directions.T
    return np.asarray(places - (places.max(axis=0) + places.min(axis=0)) / 2)


def _weights(places: Array, count: int) -> Array:
    """What each camera counts in each pose, (count, N), rows of sum 1."""
    phases = 2 * np.pi * np.arange(count) / count
    at = REACH * places.max(axis=0) * np.stack([np.cos(phases), np.sin(phases)], axis=-1)  # (count, 2)
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    spacing = max(float(np.median(np.sort(apart, axis=1)[:, 1])), 1e-9 + 0.05 * float(apart.max()))
    logits = -np.square(at[:, None] - places).sum(axis=-1) / (2 * spacing**2)
    weights = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _view(cameras: Sequence[Camera], centres: Array, width: int | None) -> Camera:
    """Intrinsics of the camera in the middle, at an even size, with the depth range of all."""
    middle = cameras[int(np.argmin(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))]
    if width is not None:
        if width < 2:
            raise CameraError(f"camera loop: wanted a view of at least 2 pixels across, got {width}")
        middle = middle.resized(width, max(round(middle.height * width / middle.width), 2))
    even = middle.cropped(0, 0, middle.width - middle.width % 2, middle.height - middle.height % 2)
    return replace(even, near=min(camera.near for camera in cameras), far=max(camera.far for camera in cameras))
