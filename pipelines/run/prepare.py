"""Prepare: the input of every method under a protocol - truth frames, source views, depth, a camera
path.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.run.claim import claim_folder
from ggvs_eval.pipelines.run.derived_files import cache_frames
from ggvs_eval.pipelines.run.run_plan import (
    PREPARATIONS,
    RunPlan,
    RunRequest,
    fit_capture,
    plan_run,
)
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.tasks.task import drop_passing


def prepare(
    root: Path,
    capture: Capture,
    protocol: Protocol,
    workers: Workers = 1,
    depth: DepthRunOptions | None = None,
    labels: Sequence[str] = (),
) -> RunPlan:
    """Plan a run and prepare it, see `prepare_run`.

    Args:
        root: the run folder; made if absent.
        depth: how depth is found; as the folder says, or the default.
    """
    return prepare_run(
        plan_run(
            RunRequest(root=root, capture=capture, protocol=protocol, labels=labels, depth=depth)
        ),
        workers,
    )


def prepare_run(plan: RunPlan, workers: Workers = 1) -> RunPlan:
    """Write protocol, capture record, truth frames and depth into a run folder.

    What is there is kept.

    Depth that only checks read is removed after them, unless the run shares it, see
    `drop_found_depth`.

    Raises:
        CaptureError: frames that cannot be read.
        DepthError: depth that cannot be computed.
        DeviceError: depth is missing, and the device that it is found on is not here or has no
            memory left.
        ProtocolError: the folder belongs to another protocol or capture.
    """
    if plan.calibration and (task := plan.calibration(workers).left()):
        task.run()
        plan = plan_run(plan.request)
    run = plan.run
    if plan.shared_root != run.root:
        _share_folders(run.root, plan.shared_root)
    claim_folder(run, plan.protocol, plan.original)
    plan.depth.write_record()
    cache_frames(plan.original, plan.frames_of_cameras(), run.root / "truth", workers)
    store = DepthStore(run.depth)
    for jobs, frames in plan.depth_work():
        plan.depth.fill(plan.capture, jobs, frames, store, workers)
    if plan.request.shared is None:
        drop_found_depth([plan])
    for preparation in PREPARATIONS.built_in().values():
        preparation.prepare(plan, workers)
    return plan


def _share_folders(root: Path, shared: Path) -> None:
    """Let a run have its frames and depth in common with others, so that K = 2 finds what K = 6 has
    computed.
    """
    root.mkdir(parents=True, exist_ok=True)
    for name in ("truth", "depth"):
        (shared / name).mkdir(parents=True, exist_ok=True)
        if not (root / name).exists():
            (root / name).symlink_to(os.path.relpath(shared / name, root), target_is_directory=True)


def drop_found_depth(plans: Sequence[RunPlan]) -> None:
    """Remove depth that only checks read, as soon as no run of those that share a store lacks a
    check.
    """
    for root in {plan.shared_root for plan in plans}:
        drop_passing(
            [task for plan in plans if plan.shared_root == root for task in plan.depth_tasks()]
        )


def prepare_truth(
    root: Path, capture: Capture, protocol: Protocol, workers: Workers = 1
) -> RunFolder:
    """Write protocol, capture record and truth frames of the test views into a run folder, as
    scoring alone needs.

    Args:
        root: the run folder; made if absent. `prepare` can continue with it.
    """
    protocol = protocol.over(capture.n_frames)
    capture, run = fit_capture(capture, protocol), RunFolder(root)
    claim_folder(run, protocol, capture)
    cache_frames(
        capture,
        dict.fromkeys(protocol.views.test, protocol.frames.numbers),
        run.root / "truth",
        workers,
    )
    return run
