"""Depth along a camera path, the same for all methods: input of the view-consistency measures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.geometry.tsdf import fusion_weights, ray_march
from ggvs_eval.pipelines.run.derived_files import MadeFiles, seen_from
from ggvs_eval.progress import track
from ggvs_eval.tasks.identity import code_of

TAU_M, NOISE_M = 0.02, 0.001  # as `OnlineOptions` has them


def write_path_depth(
    capture: Capture, poses: Sequence[tuple[Camera, dict[str, str]]], frame: int, store: DepthStore, folder: Path
) -> None:
    """Fuse the depth of each pose's source cameras and write it; what is there, and made from the same, is kept.

    Args:
        poses: each pose with its source cameras and the keys of their depth.
        folder: where ``<pose>.npy`` goes, (H, W) float32, world units, 0 = unknown.

    Reading:
        A method's own depth would hide its contradictions from the measures; this one is the same for all. It is fused as the
        online method does it (Eq. 3), without history.
    """
    files = path_files(folder, capture, poses, frame)
    for index in track(poses_left(files, len(poses)), "depth along the path"):
        target, keys = poses[index]
        depth, file = _fused_depth(capture, target, keys, frame, store), pose_file(folder, index)
        with atomic_file(file) as temporary, temporary.open("wb") as stream:
            np.save(stream, depth)
        files.note([file.name])


def path_files(folder: Path, capture: Capture, poses: Sequence[tuple[Camera, dict[str, str]]], frame: int) -> MadeFiles:
    """Return the depth of a path as a folder holds it; arguments as of `write_path_depth`."""
    made_from = {
        "poses": [seen_from(target, keys) for target, keys in poses],
        "frame": frame,
        "units_per_metre": capture.units_per_metre,
        "lengths_m": [TAU_M, NOISE_M],
        "code": code_of(__name__),
    }
    return MadeFiles(folder, made_from)


def poses_left(files: MadeFiles, n_poses: int) -> list[int]:
    """Return the poses of a path of N poses whose depth is missing or outdated."""
    poses = {pose_file(files.folder, pose).name: pose for pose in range(n_poses)}
    return [poses[name] for name in files.missing(poses)]


def read_path_depth(folder: Path, pose: int) -> NDArray[np.float32]:
    """Read the depth of one pose."""
    file = pose_file(folder, pose)
    try:
        return np.asarray(np.load(file, allow_pickle=False), dtype=np.float32)
    except (OSError, ValueError, EOFError) as error:
        raise DepthError(
            f"{file}: wanted depth of a path's pose, got: {error}; move it away and run `ggvs-eval prepare`"
        ) from error


def pose_file(folder: Path, pose: int) -> Path:
    """Return the file of one pose's depth."""
    return folder / f"{pose:04d}.npy"


def _fused_depth(capture: Capture, target: Camera, keys: dict[str, str], frame: int, store: DepthStore) -> NDArray[np.float32]:
    tau, noise = TAU_M * capture.units_per_metre, NOISE_M * capture.units_per_metre
    depths = [store.read(key, frame).depth for key in keys.values()]
    weights = [fusion_weights(depth, tau, noise) for depth in depths]
    return ray_march(target, [capture.camera(name) for name in keys], depths, weights, tau=tau).depth
