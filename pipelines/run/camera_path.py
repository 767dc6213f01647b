"""The camera path of a run: poses that the protocol lists, the capture's own, or a translation around a test view."""

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras, translated_path
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.dynerf import CameraPath, open_path
from ggvs_eval.protocol import PathCamera, Protocol


def choose_path(capture: Capture, protocol: Protocol) -> CameraPath:
    """The protocol's poses, else the capture's own path where it has one, else a translation around the first test view.

    Returns:
        Poses at the size of a test view; none where the protocol wants none.

    Reading:
        The paper moves the camera horizontally and does not say from where to where; ours spans the nearest cameras on both
        sides, at the protocol's first instant.
    """
    middle = capture.camera(protocol.views.test[0])
    if protocol.path.poses == 0:
        return CameraPath((), None, 0.0)
    if protocol.path.cameras:
        return CameraPath(_chosen_poses(protocol.path.cameras, middle), None, 0.0)
    own_path = open_path(capture.path)
    if own_path is not None and _shows_its_instant(capture, own_path):
        return replace(own_path, cameras=tuple(pose.resized(*middle.size) for pose in own_path.cameras))
    neighbour = nearest_cameras(middle, capture.cameras, 2)[-1]
    span = 2 * float(np.linalg.norm(neighbour.centre - middle.centre))
    return CameraPath(tuple(translated_path(middle, span, protocol.path.poses)), None, 0.0)


def _chosen_poses(poses: Sequence[PathCamera], view: Camera) -> tuple[Camera, ...]:
    """Poses that the protocol lists, at the size of a test view."""
    cameras = (Camera.from_json(f"path{index:04d}", asdict(pose)) for index, pose in enumerate(poses))
    return tuple(camera.resized(*view.size) for camera in cameras)


def _shows_its_instant(capture: Capture, path: CameraPath) -> bool:
    """Tell whether the capture's own path was rendered at an instant that can be seen: not where another one is held still."""
    edit = capture.edit
    return edit is None or not edit.hold_frames or round(path.time_s * capture.fps) == edit.hold_frame
