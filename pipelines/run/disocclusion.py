"""Disocclusion: the part of a test view that no source camera sees, which every method must
invent.
"""

from functools import partial
from pathlib import Path

import numpy as np

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.files.images import write_image
from ggvs_eval.geometry.splat import COVERED_ALPHA, splat_depth
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.method import NEAR_M
from ggvs_eval.pipelines.methods.render_unit import SourcePlan
from ggvs_eval.pipelines.run.derived_files import seen_from
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.run_folder import frame_names, frame_numbers, frame_path
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.run_tasks import make_files
from ggvs_eval.tasks.task import FileTask


def complete(plan: RunPlan) -> RunPlan:
    """Return the plan as it is: masks need the depth that it has anyway."""
    return plan


def tasks(plan: RunPlan) -> list[FileTask]:
    """Return what writes a mask of every frame of every test view; nothing if no metric wants them.

    It is white where no source sees the view.

    Reading:
        The paper speaks of disoccluded regions and gives no mask. Here a pixel is disoccluded where
        no source view, splatted forward by its estimated depth (Sec. 3.1), covers it by half;
        errors of that depth are part of the mask.
    """
    if not any(name.endswith("_disoccluded") for name in plan.protocol.measurement.metrics):
        return []
    made_with = {"units_per_metre": plan.capture.units_per_metre, "code": code_of(__name__)}
    return [
        FileTask(
            name=f"areas of {view} without a source camera",
            folder=plan.run.disoccluded(view),
            inputs=seen_from(sources.target, sources.depth_keys) | made_with,
            files=frame_names(plan.frames),
            make=partial(
                _write,
                plan.capture,
                sources,
                DepthStore(plan.run.depth),
                plan.run.disoccluded(view),
            ),
            kind="mask",
        )
        for view, sources in plan.plans.items()
    ]


def prepare(plan: RunPlan, workers: Workers) -> None:
    """Write the masks that are missing."""
    make_files(tasks(plan), workers, "areas without a source camera")


def _write(
    capture: Capture, sources: SourcePlan, store: DepthStore, folder: Path, files: tuple[str, ...]
) -> None:
    near = NEAR_M * capture.units_per_metre
    target = sources.target
    for index in frame_numbers(files):
        covered = np.zeros((target.height, target.width), np.float32)
        for name, key in sources.depth_keys.items():
            depth = store.read(key, index).depth
            splat = splat_depth(capture.camera(name), depth, target, near=near)
            covered = np.maximum(covered, splat.alpha)
        mask = np.where(covered < COVERED_ALPHA, 255, 0).astype(np.uint8)
        write_image(frame_path(folder, index), np.repeat(mask[..., None], 3, axis=-1))
