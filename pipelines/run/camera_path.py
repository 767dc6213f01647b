"""Camera path: poses that a camera moves along at one instant, what it would have seen there, and the depth along it."""

from dataclasses import asdict, replace

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras, translated_path
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.llff import CameraPath, open_path
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.methods.stage_costs import DECODED
from ggvs_eval.pipelines.run.derived_files import cache_path, path_left
from ggvs_eval.pipelines.run.path_depth import path_files, poses_left, write_path_depth
from ggvs_eval.pipelines.run.run_plan import TRUTH_BYTES, Piece, RunPlan
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import write_json

DEPTH_COST, DEPTH_BYTES = 0.6, 4.0  # core-seconds per megapixel, see `stage_costs`; bytes per pixel


def complete(plan: RunPlan) -> RunPlan:
    """Return the plan with the poses, each with its sources."""
    path, protocol, capture = choose_path(plan.original, plan.protocol), plan.protocol, plan.original
    frame = protocol.path.frame if protocol.path.cameras else round(path.time_s * capture.fps)
    frame = min(max(frame, protocol.frames.start), capture.n_frames - 1)
    poses = tuple(plan.depth.sources(path.cameras).values())
    return replace(plan, path=poses, path_frame=frame, path_images=path.images)


def choose_path(capture: Capture, protocol: Protocol) -> CameraPath:
    """Return the protocol's poses, else the capture's own path where it has one, else a translation around the first test view.

    Returns:
        Poses at the size of a test view; none if the protocol wants none.

    Reading:
        The paper moves the camera horizontally and does not say from where to where; this one spans the nearest cameras on both
        sides, at the protocol's first instant.
    """
    middle = capture.camera(protocol.views.test[0])
    if protocol.path.poses == 0:
        return CameraPath((), None, 0.0)
    if protocol.path.cameras:
        poses = (Camera.from_json(f"path{index:04d}", asdict(pose)) for index, pose in enumerate(protocol.path.cameras))
        return CameraPath(tuple(pose.resized(*middle.size) for pose in poses), None, 0.0)
    own_path, edit = open_path(capture.path), capture.edit
    held = edit.hold_frame if edit and edit.hold_frames else None  # the one instant that can be seen
    if own_path is not None and held in (None, round(own_path.time_s * capture.fps)):
        return replace(own_path, cameras=tuple(pose.resized(*middle.size) for pose in own_path.cameras))
    neighbour = nearest_cameras(middle, capture.cameras, 2)[-1]
    span = 2 * float(np.linalg.norm(neighbour.centre - middle.centre))
    return CameraPath(tuple(translated_path(middle, span, protocol.path.poses)), None, 0.0)


def work_left(plan: RunPlan) -> list[Piece]:
    """List the true images and the depth along the path that are missing or were changed."""
    missing = []
    if plan.path_images is not None:
        folder, resize_filter = plan.run.path("truth"), plan.protocol.synthesis.resize_filter
        poses = path_left(plan.path_images, plan.path[0].target.size, resize_filter, folder)
        missing.append(plan.piece("truth", folder, len(poses), DECODED, TRUTH_BYTES))
    files = path_files(plan.run.path_depth, plan.capture, _sources(plan), plan.path_frame)
    n_poses = len(poses_left(files, len(plan.path)))
    return [*missing, plan.piece("path depth", files.folder, n_poses, DEPTH_COST, DEPTH_BYTES)]


def prepare(plan: RunPlan, _workers: Workers) -> None:
    """Write the path's images where the capture has them, its poses with their sources, and its depth."""
    if not plan.path:
        return
    run, targets = plan.run, [pose.target for pose in plan.path]
    if plan.path_images is not None:
        resize_filter = plan.protocol.synthesis.resize_filter
        cache_path(plan.path_images, targets[0].size, resize_filter, run.path("truth"))
    record = {
        "frame": plan.path_frame,
        "centres": [target.centre.tolist() for target in targets],
        "cameras": [target.to_json() for target in targets],
        "sources": [list(pose.depth_keys) for pose in plan.path],
    }
    write_json(run.path_record, record)
    store = DepthStore(run.depth)
    write_path_depth(plan.capture, _sources(plan), plan.path_frame, store, run.path_depth)


def _sources(plan: RunPlan) -> list[tuple[Camera, dict[str, str]]]:
    return [(pose.target, pose.depth_keys) for pose in plan.path]
