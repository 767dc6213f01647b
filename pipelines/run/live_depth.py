"""Time of live depth: how long a picture waits for the depth of its sources where depth is computed
as frames arrive.
"""

from ggvs_eval.jobs.engine import Workers
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.run_folder import write_json
from ggvs_eval.tasks.task import AnyTask

TIMED_FRAMES = 4  # of each test view, behind one that warms caches


def complete(plan: RunPlan) -> RunPlan:
    """Return the plan as it is."""
    return plan


def tasks(_plan: RunPlan) -> list[AnyTask]:
    """Return nothing: a time is measured once, and depends on the machine alone."""
    return []


def prepare(plan: RunPlan, _workers: Workers) -> None:
    """Measure it on the first frames of each test view, once, in this process alone.

    Nothing if depth is not live.

    What is timed is what the run's depth was made by: all sources of the view together, by pairs
    that are matched once or in one batch on a GPU, and each map checked against the others. The
    seconds of each frame and the threads are written next to the depth's record.
    """
    run, capture = plan.run, plan.capture
    if plan.protocol.stream is None or not run.has_live_depth or run.live_depth_record.is_file():
        return
    seconds: list[float] = []
    for source_plan in plan.plans.values():
        partners = {
            job.camera_name: job.partner_names for job in source_plan.jobs if job.partner_names
        }
        rig = plan.depth.live_rig(capture.cameras, partners) if partners else None
        if rig is None:
            continue
        names, frames = list(partners), plan.frames[: TIMED_FRAMES + 1]
        for frame in frames:
            images = {name: capture.frame(name, frame) for name in rig.needed(names)}
            begun_s = rig.clock_s()
            rig.estimate(names, images)
            if frame != frames[0] or len(frames) == 1:
                seconds.append(rig.clock_s() - begun_s)
    if seconds:
        write_json(run.live_depth_record, {"seconds": seconds, "threads": get_threads()})
