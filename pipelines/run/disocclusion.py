"""Disocclusion: the part of a test view that no source camera sees, which every method must invent."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.files.images import write_image
from ggvs_eval.geometry.splat import COVERED_ALPHA, splat_depth
from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.jobs.engine import Workers, run_all
from ggvs_eval.method import NEAR_M
from ggvs_eval.pipelines.run.derived_files import MadeFiles, seen_from
from ggvs_eval.run_folder import frame_path


def write_disocclusions(
    capture: Capture, views: Mapping[str, tuple[Camera, dict[str, str]]], frames: range, store: Path, root: Path, workers: Workers
) -> None:
    """Write a mask of every frame of every test view; what is there, and made from the same, is kept.

    Args:
        views: test view -> its camera, its source cameras and the keys of their depth.
        root: where ``<view>/<frame>.png`` goes, white where no source sees the view.

    Reading:
        The paper speaks of disoccluded regions and gives no mask. Here a pixel is disoccluded where no source view, splatted
        forward by its estimated depth (Sec. 3.1), covers it by half; errors of that depth are part of the mask.
    """
    plans = [(mask_files(root / view, capture, target, keys), target, keys) for view, (target, keys) in views.items()]
    missing = [plan for plan in plans if plan[0].missing_frames(frames)]
    run_all(partial(_write, capture, frames, store), missing, workers, "areas without a source camera")


def mask_files(folder: Path, capture: Capture, target: Camera, keys: Mapping[str, str]) -> MadeFiles:
    """Return the masks of one view as a folder holds them; arguments as of `write_disocclusions`."""
    code = code_identity(__name__, splat_depth.__module__, unfollowed=(__name__,))
    return MadeFiles(folder, seen_from(target, keys) | {"units_per_metre": capture.units_per_metre, "code": code})


def _write(capture: Capture, frames: range, store: Path, view: tuple[MadeFiles, Camera, dict[str, str]]) -> None:
    (files, target, keys), depths, near = view, DepthStore(store), NEAR_M * capture.units_per_metre
    for index in files.missing_frames(frames):
        covered = np.zeros((target.height, target.width), np.float32)
        for name, key in keys.items():
            depth = depths.read(key, index).depth
            covered = np.maximum(covered, splat_depth(capture.camera(name), depth, target, near=near).alpha)
        mask = np.where(covered < COVERED_ALPHA, 255, 0).astype(np.uint8)
        write_image(frame_path(files.folder, index), np.repeat(mask[..., None], 3, axis=-1))
        files.note_frames([index])
