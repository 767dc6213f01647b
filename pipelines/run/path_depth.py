"""Depth along a camera path, the same for all methods: input of the view-consistency measures."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.geometry.tsdf import fusion_weights, ray_march
from ggvs_eval.pipelines.run.derived_files import seen_from
from ggvs_eval.progress import track
from ggvs_eval.run_folder import frame_names, frame_numbers
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.run_tasks import make_files
from ggvs_eval.tasks.task import FileTask

TAU_M, NOISE_M = 0.02, 0.001  # as `OnlineOptions` has them


def write_path_depth(
    capture: Capture,
    poses: Sequence[tuple[Camera, dict[str, str]]],
    frame: int,
    store: DepthStore,
    folder: Path,
) -> None:
    """Write the depth of each pose that is missing; arguments as of `path_depth_task`."""
    make_files([path_depth_task(capture, poses, frame, store, folder)], 1, "depth along the path")


def path_depth_task(
    capture: Capture,
    poses: Sequence[tuple[Camera, dict[str, str]]],
    frame: int,
    store: DepthStore,
    folder: Path,
) -> FileTask:
    """Return what fuses the depth of each pose's source cameras.

    Args:
        poses: each pose with its source cameras and the keys of their depth.
        folder: where ``<pose>.npy`` goes, (H, W) float32, world units, 0 = unknown.

    Reading:
        A method's own depth would hide its contradictions from the measures; this one is the same
        for all. It is fused as the online method does it (Eq. 3), without history.
    """
    inputs = {
        "poses": [seen_from(target, keys) for target, keys in poses],
        "frame": frame,
        "units_per_metre": capture.units_per_metre,
        "lengths_m": [TAU_M, NOISE_M],
        "code": code_of(__name__),
    }
    return FileTask(
        name="depth along the path",
        folder=folder,
        inputs=inputs,
        files=frame_names(range(len(poses)), ".npy"),
        make=partial(_write, capture, poses, frame, store, folder),
        kind="path depth",
    )


def _write(
    capture: Capture,
    poses: Sequence[tuple[Camera, dict[str, str]]],
    frame: int,
    store: DepthStore,
    folder: Path,
    files: tuple[str, ...],
) -> None:
    for index in track(frame_numbers(files), "depth along the path"):
        target, keys = poses[index]
        depth = _fused_depth(capture, target, keys, frame, store)
        with atomic_file(pose_file(folder, index)) as temporary, temporary.open("wb") as stream:
            np.save(stream, depth)


def read_path_depth(folder: Path, pose: int) -> NDArray[np.float32]:
    """Read the depth of one pose."""
    file = pose_file(folder, pose)
    try:
        return np.asarray(np.load(file, allow_pickle=False), dtype=np.float32)
    except (OSError, ValueError, EOFError) as error:
        raise DepthError(
            f"{file}: wanted depth of a path's pose, got: {error}; move it away and run `ggvs-eval "
            f"prepare`"
        ) from error


def pose_file(folder: Path, pose: int) -> Path:
    """Return the file of one pose's depth."""
    return folder / f"{pose:04d}.npy"


def _fused_depth(
    capture: Capture, target: Camera, keys: dict[str, str], frame: int, store: DepthStore
) -> NDArray[np.float32]:
    tau, noise = TAU_M * capture.units_per_metre, NOISE_M * capture.units_per_metre
    depths = [store.read(key, frame).depth for key in keys.values()]
    weights = [fusion_weights(depth, tau, noise) for depth in depths]
    return ray_march(
        target, [capture.camera(name) for name in keys], depths, weights, tau=tau
    ).depth
