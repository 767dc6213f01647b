"""Camera path: poses that a camera moves along at one instant, what it would have seen there, and
the depth along it.
"""

from dataclasses import asdict, replace

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras, translated_path
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.llff import CameraPath, open_path
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.run.derived_files import path_task
from ggvs_eval.pipelines.run.path_depth import path_depth_task
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import write_json
from ggvs_eval.tasks.run_tasks import make_files
from ggvs_eval.tasks.task import FileTask


def complete(plan: RunPlan) -> RunPlan:
    """Return the plan with the poses, each with its sources."""
    path, protocol, capture = (
        choose_path(plan.original, plan.protocol),
        plan.protocol,
        plan.original,
    )
    frame = protocol.path.frame if protocol.path.cameras else round(path.time_s * capture.fps)
    frame = min(max(frame, protocol.frames.start), capture.n_frames - 1)
    poses = tuple(plan.depth.sources(path.cameras).values())
    return replace(plan, path=poses, path_frame=frame, path_images=path.images)


def choose_path(capture: Capture, protocol: Protocol) -> CameraPath:
    """Return the protocol's poses, else the capture's own path where it has one, else a translation
    around the first test view.

    Returns:
        Poses at the size of a test view; none if the protocol wants none.

    Reading:
        The paper moves the camera horizontally and does not say from where to where; this one spans
        the nearest cameras on both sides, at the protocol's first instant.
    """
    middle = capture.camera(protocol.views.test[0])
    if protocol.path.poses == 0:
        return CameraPath((), None, 0.0)
    if protocol.path.cameras:
        poses = (
            Camera.from_json(f"path{index:04d}", asdict(pose))
            for index, pose in enumerate(protocol.path.cameras)
        )
        return CameraPath(tuple(pose.resized(*middle.size) for pose in poses), None, 0.0)
    own_path, edit = open_path(capture.path), capture.edit
    # the one instant that can be seen
    held_frame = edit.hold_frame if edit and edit.hold_frames else None
    if own_path is not None and held_frame in (None, round(own_path.time_s * capture.fps)):
        return replace(
            own_path, cameras=tuple(pose.resized(*middle.size) for pose in own_path.cameras)
        )
    neighbour = nearest_cameras(middle, capture.cameras, 2)[-1]
    span = 2 * float(np.linalg.norm(neighbour.centre - middle.centre))
    return CameraPath(tuple(translated_path(middle, span, protocol.path.poses)), None, 0.0)


def tasks(plan: RunPlan) -> list[FileTask]:
    """Return what writes the true images along the path and its depth.

    Nothing if there is no path.
    """
    if not plan.path:
        return []
    true_images = []
    if plan.path_images is not None:
        size, resize_filter = plan.path[0].target.size, plan.protocol.synthesis.resize_filter
        true_images.append(path_task(plan.path_images, size, resize_filter, plan.run.path("truth")))
    poses = [(pose.target, pose.depth_keys) for pose in plan.path]
    depths = DepthStore(plan.run.depth)
    return [
        *true_images,
        path_depth_task(plan.capture, poses, plan.path_frame, depths, plan.run.path_depth),
    ]


def prepare(plan: RunPlan, _workers: Workers) -> None:
    """Write the path's images where the capture has them, its poses with their sources, and its
    depth.
    """
    if not plan.path:
        return
    targets = [pose.target for pose in plan.path]
    record = {
        "frame": plan.path_frame,
        "centres": [target.centre.tolist() for target in targets],
        "cameras": [target.to_json() for target in targets],
        "sources": [list(pose.depth_keys) for pose in plan.path],
    }
    write_json(plan.run.path_record, record)
    make_files(tasks(plan), 1, "camera path")
