"""Prepare: the input of every method under a protocol - truth frames, source views, depth, a camera path.

Live depth is timed: how long a picture waits for the depth of its sources where depth is computed as frames arrive.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import DeviceError
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions, finds_live
from ggvs_eval.pipelines.offline.depth.fill_store import drop_found, prepare_depth
from ggvs_eval.pipelines.offline.depth.rig_depth import RigDepth
from ggvs_eval.pipelines.run.claim import claim_folder
from ggvs_eval.pipelines.run.derived_files import cache_frames, cache_path
from ggvs_eval.pipelines.run.disocclusion import write_disocclusions
from ggvs_eval.pipelines.run.path_depth import write_path_depth
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, fit_capture, plan_run
from ggvs_eval.pipelines.run.score_path import write_path_record
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder, write_json

TIMED_FRAMES = 4  # of each test view, behind one that warms caches


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
    return prepare_run(plan_run(RunRequest(root, capture, protocol, labels, depth)), workers)


def prepare_run(plan: RunPlan, workers: Workers = 1) -> RunPlan:
    """Write protocol, capture record, truth frames and depth into a run folder; what is there is kept.

    Depth that only checks read is removed after them, unless the run shares it, see `drop_found_depth`.

    Raises:
        CaptureError: frames that cannot be read.
        DepthError: depth that cannot be computed.
        DeviceError: depth is missing, and the device that it is found on is not here or has no memory left.
        ProtocolError: the folder belongs to another protocol or capture.
    """
    run = plan.run
    if plan.shared_root != run.root:
        _share_folders(run.root, plan.shared_root)
    claim_folder(run, plan.protocol, plan.original)
    if plan.compared or not run.depth_record.is_file():  # which a run without depth may have left undecided
        write_json(run.depth_record, plan.depth.record(plan.depth_device) | plan.compared)
    cache_frames(plan.original, plan.frames_of_cameras(), run.root / "truth", workers)
    store = DepthStore(run.depth)
    _write_path_truth(plan)
    _fill_store(plan, store, workers)
    if plan.request.shared is None:
        drop_found_depth([plan])
    time_live_depth(plan)
    if any(name.endswith("_disoccluded") for name in plan.protocol.measurement.metrics):
        views = {view: (each.target, each.depth_keys) for view, each in plan.plans.items()}
        write_disocclusions(plan.capture, views, plan.frames, run.depth, run.root / "disoccluded", workers)
    if plan.path:
        poses = [(pose.target, pose.depth_keys) for pose in plan.path]
        write_path_depth(plan.capture, poses, plan.path_frame, store, run.path_depth)
    return plan


def _share_folders(root: Path, shared: Path) -> None:
    """Let a run have its frames and depth in common with others, so that K = 2 finds what K = 6 has computed."""
    root.mkdir(parents=True, exist_ok=True)
    for name in ("truth", "depth"):
        (shared / name).mkdir(parents=True, exist_ok=True)
        if not (root / name).exists():
            (root / name).symlink_to(os.path.relpath(shared / name, root), target_is_directory=True)


def _fill_store(prepared: RunPlan, store: DepthStore, workers: Workers) -> None:
    """Compute the depth that is missing, where the run's other depth was computed."""
    try:
        for jobs, frames in prepared.depth_work():
            prepare_depth(prepared.capture, jobs, frames, store, prepared.depth_options, workers)
    except DeviceError as error:
        record = f"{prepared.run.depth_record}: this run's depth is found on {prepared.depth_device}"
        raise DeviceError(f"{record}: {error}; or use a new run folder") from error


def drop_found_depth(plans: Sequence[RunPlan]) -> None:
    """Remove depth that only checks read, as soon as no run of those that share a store lacks a check."""
    for root in {plan.shared_root for plan in plans}:
        work = [each for plan in plans if plan.shared_root == root for each in plan.depth_work()]
        drop_found(work, DepthStore(root / "depth"))


def prepare_truth(root: Path, capture: Capture, protocol: Protocol, workers: Workers = 1) -> RunFolder:
    """Write protocol, capture record and truth frames of the test views into a run folder, as scoring alone needs.

    Args:
        root: the run folder; made if absent. `prepare` can continue with it.
    """
    protocol = protocol.over(capture.n_frames)
    capture, run = fit_capture(capture, protocol), RunFolder(root)
    claim_folder(run, protocol, capture)
    cache_frames(capture, dict.fromkeys(protocol.views.test, protocol.frames.numbers), run.root / "truth", workers)
    return run


def _write_path_truth(prepared: RunPlan) -> None:
    """Write the path's images where the capture has them, and its poses."""
    if prepared.path_images is not None:
        size, resize_filter = prepared.path[0].target.size, prepared.protocol.synthesis.resize_filter
        cache_path(prepared.path_images, size, resize_filter, prepared.run.path("truth"))
    write_path_record(prepared.run, prepared.path_frame, [(plan.target, list(plan.depth_keys)) for plan in prepared.path])


def time_live_depth(plan: RunPlan) -> None:
    """Measure it on the first frames of each test view, once, in this process alone; nothing if depth is not live.

    What is timed is what the run's depth was made by: all sources of the view together, by pairs that are matched once or in one
    batch on a GPU, and each map checked against the others. The seconds of each frame and the threads are written next to the
    depth's record.
    """
    options, run, capture = plan.depth_options, plan.run, plan.capture
    is_live = finds_live(plan.depth.record(plan.depth_device))
    if plan.protocol.stream is None or not is_live or run.live_depth_record.is_file():
        return
    seconds: list[float] = []
    for source_plan in plan.plans.values():
        partners = {job.camera_name: job.partner_names for job in source_plan.jobs if job.partner_names}
        if not partners:
            continue
        rig = RigDepth(capture.cameras, options, partners)
        names, frames = list(partners), plan.frames[: TIMED_FRAMES + 1]
        for frame in frames:
            images = {name: capture.frame(name, frame) for name in rig.needed(names)}
            begun_s = rig.clock_s()
            rig.estimate(names, images)
            if frame != frames[0] or len(frames) == 1:
                seconds.append(rig.clock_s() - begun_s)
    if seconds:
        write_json(run.live_depth_record, {"seconds": seconds, "threads": get_threads()})
