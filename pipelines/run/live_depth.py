"""Time of live depth: how long a picture waits for the depth of its sources where depth is computed as frames arrive."""

from time import perf_counter

from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.offline.depth.camera_depth import check_depth, finish
from ggvs_eval.pipelines.offline.stereo.live import LiveMatcher, RigEstimator
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.run_folder import write_json

TIMED_FRAMES = 4  # of each test view, behind one that warms caches


def time_live_depth(plan: RunPlan) -> None:
    """Measure it on the first frames of each test view, once, in this process alone; nothing where depth is not live.

    What is timed is what the run's depth was made by: all sources of the view together, each pair of cameras matched once, and
    each map held against the others. Written beside the depth's record are the seconds of each frame and the threads.
    """
    options, run = plan.depth_options, plan.run
    if plan.protocol.stream is None or not isinstance(options.matcher, LiveMatcher) or run.live_depth_record.is_file():
        return
    seconds: list[float] = []
    for source_plan in plan.plans.values():
        jobs = [job for job in source_plan.jobs if job.partner_names]
        if not jobs:
            continue
        matched = [(job.camera_name, *job.partner_names) for job in jobs]
        names = list(dict.fromkeys(name for each in matched for name in each))
        cameras = {name: plan.capture.camera(name) for name in names}
        rig = RigEstimator([*cameras.values()], matched, options.matcher, options.error_px)
        frames = plan.frames[: TIMED_FRAMES + 1]
        for frame in frames:
            images = {name: plan.capture.frame(name, frame) for name in names}
            begun = perf_counter()
            found = {job.camera_name: finish(each, options) for job, each in zip(jobs, rig.estimate(images), strict=True)}
            for job in jobs:
                others = [other.camera_name for other in job.checked_with if other.camera_name in found]
                beside = [(cameras[other], found[other]) for other in others]
                check_depth(cameras[job.camera_name], found[job.camera_name], beside, options)
            if frame != frames[0] or len(frames) == 1:
                seconds.append(perf_counter() - begun)
    if seconds:
        write_json(run.live_depth_record, {"seconds": seconds, "threads": get_threads()})
