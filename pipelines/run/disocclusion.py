"""Disocclusion: the part of a test view that no source camera sees, which every method must invent."""

from functools import partial

import numpy as np

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.files.images import write_image
from ggvs_eval.geometry.splat import COVERED_ALPHA, splat_depth
from ggvs_eval.jobs.engine import Workers, run_all
from ggvs_eval.method import NEAR_M
from ggvs_eval.pipelines.methods.render_unit import SourcePlan
from ggvs_eval.pipelines.run.derived_files import MadeFiles, seen_from
from ggvs_eval.pipelines.run.run_plan import Piece, RunPlan
from ggvs_eval.run_folder import frame_path
from ggvs_eval.tasks.identity import code_of

MASK_COST = 0.3  # core-seconds per megapixel, see `stage_costs`


def complete(plan: RunPlan) -> RunPlan:
    """Return the plan as it is: masks need the depth that it has anyway."""
    return plan


def work_left(plan: RunPlan) -> list[Piece]:
    """List the masks that are missing, of each test view."""
    return [plan.piece("mask", files.folder, len(files.missing_frames(plan.frames)), MASK_COST) for files, _ in _masks(plan)]


def prepare(plan: RunPlan, workers: Workers) -> None:
    """Write a mask of every frame of every test view; what is there, and made from the same, is kept.

    It is white where no source sees the view.

    Reading:
        The paper speaks of disoccluded regions and gives no mask. Here a pixel is disoccluded where no source view, splatted
        forward by its estimated depth (Sec. 3.1), covers it by half; errors of that depth are part of the mask.
    """
    views = [view for view in _masks(plan) if view[0].missing_frames(plan.frames)]
    write = partial(_write, plan.capture, plan.frames, DepthStore(plan.run.depth))
    run_all(write, views, workers, "areas without a source camera")


def _masks(plan: RunPlan) -> list[tuple[MadeFiles, SourcePlan]]:
    """Return the masks of each test view as its folder holds them; none if no metric wants them."""
    if not any(name.endswith("_disoccluded") for name in plan.protocol.measurement.metrics):
        return []
    code = code_of(__name__)
    made_with = {"units_per_metre": plan.capture.units_per_metre, "code": code}
    masks = []
    for view, sources in plan.plans.items():
        made_from = seen_from(sources.target, sources.depth_keys) | made_with
        masks.append((MadeFiles(plan.run.disoccluded(view), made_from), sources))
    return masks


def _write(capture: Capture, frames: range, store: DepthStore, view: tuple[MadeFiles, SourcePlan]) -> None:
    (files, sources), near = view, NEAR_M * capture.units_per_metre
    target = sources.target
    for index in files.missing_frames(frames):
        covered = np.zeros((target.height, target.width), np.float32)
        for name, key in sources.depth_keys.items():
            depth = store.read(key, index).depth
            splat = splat_depth(capture.camera(name), depth, target, near=near)
            covered = np.maximum(covered, splat.alpha)
        mask = np.where(covered < COVERED_ALPHA, 255, 0).astype(np.uint8)
        write_image(frame_path(files.folder, index), np.repeat(mask[..., None], 3, axis=-1))
        files.note_frames([index])
