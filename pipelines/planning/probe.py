"""A short trial of a run on this machine: two instants of one view through every stage, in a process like those of the run.

Frames and depth that the trial makes lie where the run will look for them; its few renders are thrown away.
"""

import resource
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ggvs_eval.baselines.gaussians import NEAR_M
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.files.images import quantise, write_image
from ggvs_eval.geometry.splat import PixelGaussians, splat
from ggvs_eval.method import Instant, LookaheadMethod, SourceView
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.checked_depth import check_depth
from ggvs_eval.pipelines.offline.depth.depth_stream import DepthStream
from ggvs_eval.pipelines.offline.depth.fill_store import depth_spec
from ggvs_eval.pipelines.offline.sensor.sensor_depth import SensorDepthEstimator
from ggvs_eval.pipelines.planning.rates import Rates
from ggvs_eval.pipelines.planning.score_trial import timed, try_scoring
from ggvs_eval.pipelines.run.frame_cache import CachedFrames
from ggvs_eval.pipelines.run.path_depth import write_path_depth
from ggvs_eval.pipelines.run.prepare import Prepared, SourcePlan
from ggvs_eval.run_folder import DIAGNOSTICS, RunFolder, frame_path

INSTANTS = 2  # the first of a method or a metric pays for what is loaded and compiled once
SLOW_S = 10.0  # a method whose first frame takes so long is not asked for another: what it loads is little of that
KIB = 1024


def probe(planned: Prepared, options: DepthOptions, specs: Mapping[str, MethodSpec], shared: Path, submitted_s: float) -> Rates:
    """Try two instants of the first test view; runs in a worker.

    Args:
        planned: the run, at synthesis size; its folder exists.
        options: how depth is found.
        specs: label -> method.
        shared: folder whose truth/ and depth/ the run uses.
        submitted_s: when the process was asked for, seconds since 1970.
    """
    begun_s = time.time()
    view, plan = next(iter(planned.plans.items()))
    frames = planned.frames[:INSTANTS]
    truth_s, capture = _try_truth(planned.capture, view, plan, frames, options, shared / "truth")
    store, scratch = DepthStore(shared / "depth"), RunFolder(planned.run.root / ".probe.tmp")
    shutil.rmtree(scratch.root, ignore_errors=True)
    try:
        depth_s, check_s = _try_depth(capture, plan.jobs, frames, store, options)
        if not depth_s and _depth_is_left(planned, store, options):  # a run that goes on: what it wants to know is stored
            depth_s, check_s = _try_depth(capture, plan.jobs[:1], frames, DepthStore(scratch.depth), options)
        mask_s = _again(lambda: _cover(capture, plan, frames[0], store))
        pose = [(plan.target, plan.depth_keys)]
        pose_depth_s = (
            timed(lambda: write_path_depth(capture, pose, frames[0], store, scratch.path_depth)) if planned.path else 0.0
        )
        methods = {
            label: _try_method(capture, plan, frames, store, spec, scratch.renders(label, view)) for label, spec in specs.items()
        }
        score_setup_s, score_s, plain_score_s = try_scoring(planned, scratch, view, frames, list(specs), shared / "truth")
        pictures = [(file.stat().st_size, DIAGNOSTICS in file.parts) for file in (scratch.root / "renders").rglob("*.png")]
    finally:
        shutil.rmtree(scratch.root, ignore_errors=True)
    truths = [file.stat().st_size for file in (shared / "truth").rglob("*.png")]
    return Rates(
        max(begun_s - submitted_s, 0.0),
        truth_s,
        depth_s,
        check_s,
        mask_s,
        pose_depth_s,
        {label: setup_s for label, (setup_s, _) in methods.items()},
        {label: step_s for label, (_, step_s) in methods.items()},
        score_setup_s,
        score_s,
        plain_score_s,
        _most_memory(),
        sum(truths) / len(truths),
        sum(size for size, _ in pictures) / max(sum(not is_inside for _, is_inside in pictures), 1),
        time.time() - submitted_s,
    )


def _try_truth(
    capture: Capture, view: str, plan: SourcePlan, frames: range, options: DepthOptions, folder: Path
) -> tuple[float, Capture]:
    """Seconds per captured frame, and the capture read from those on disk."""
    names = dict.fromkeys([view, *(name for job in plan.jobs for each in _with_checks(job) for name in _cameras(each))])
    start = options.time.first_needed(frames.start)
    wanted = {name: list(range(frames.start if name == view else start, frames.stop)) for name in names}
    begun_s, n_written = time.perf_counter(), 0
    for name, numbers in wanted.items():
        missing = {t for t in numbers if not frame_path(folder / name, t).is_file()}
        for index in sorted(missing):
            write_image(frame_path(folder / name, index), capture.frame(name, index))
        n_written += len(missing)
    seconds = time.perf_counter() - begun_s
    sources = [
        CachedFrames(folder / name, capture.n_frames, source.digest) if name in wanted else source
        for name, source in zip(capture.camera_names, capture.sources, strict=True)
    ]
    return seconds / max(n_written, 1), replace(capture, sources=tuple(sources))


def _depth_is_left(planned: Prepared, store: DepthStore, options: DepthOptions) -> bool:
    """Whether a test view lacks depth of its last frame."""
    keys = {_key(planned.capture, job, options) for plan in planned.plans.values() for job in plan.jobs}
    return not all(store.has(key, planned.frames[-1]) for key in keys)


def _try_depth(
    capture: Capture, jobs: Sequence[DepthJob], frames: range, store: DepthStore, options: DepthOptions
) -> tuple[float, float]:
    """Seconds per depth map as it is found, and as it is held against others; what is stored already costs nothing."""
    found_s: list[float] = []
    for found in dict.fromkeys(each for job in jobs for each in _with_checks(job)):
        found_s += _find_depth(capture, found, frames, store, options)
    checked_s: list[float] = []
    for job in (job for job in jobs if job.checked_with):
        key = store.write_spec(depth_spec(capture, job, options))
        own, *others = ((each.camera_name, _key(capture, each, options)) for each in _with_checks(job))
        for frame in (t for t in frames if not store.has(key, t)):
            begun_s = time.perf_counter()
            views = [(capture.camera(name), store.read(other, frame)) for name, other in others]
            store.write(key, frame, check_depth(capture.camera(own[0]), store.read(own[1], frame), views, options))
            checked_s.append(time.perf_counter() - begun_s)
    return _usual(found_s), _usual(checked_s)


def _find_depth(capture: Capture, job: DepthJob, frames: range, store: DepthStore, options: DepthOptions) -> list[float]:
    """Store depth as it is found; seconds of each map."""
    key, seconds = store.write_spec(depth_spec(capture, job, options)), []
    if all(store.has(key, frame) for frame in frames):
        return []
    camera, *partners = (capture.camera(name) for name in _cameras(job))
    measured = capture.extras_of(camera.name).depth
    if not partners and measured is not None and options.sensor is not None:
        sensor = SensorDepthEstimator(camera, measured, options.sensor)
        for frame in frames:
            begun_s = time.perf_counter()
            store.write(key, frame, sensor.at(frame, capture.frame(camera.name, frame)))
            seconds.append(time.perf_counter() - begun_s)
        return seconds
    stream = DepthStream(camera, partners, options)
    for frame in range(options.time.first_needed(frames.start), frames.stop):
        begun_s = time.perf_counter()
        image, *others = (capture.frame(name, frame) for name in _cameras(job))
        depth_map = stream.step(frame, image, others)
        if frame in frames and not store.has(key, frame):
            store.write(key, frame, depth_map)
        seconds.append(time.perf_counter() - begun_s)
    return seconds


def _try_method(
    capture: Capture, plan: SourcePlan, frames: range, store: DepthStore, spec: MethodSpec, folder: Path
) -> tuple[float, float]:
    """Seconds beyond the usual until the first frame of a method is there, and of a usual frame."""
    begun_s = time.perf_counter()
    method = spec.make()
    if isinstance(method, LookaheadMethod):
        method.look_ahead(_instant(capture, plan, frame, store) for frame in reversed(frames))
    setup_s, seconds = time.perf_counter() - begun_s, []
    for frame in frames:
        begun_s = time.perf_counter()
        image = quantise(method.step(_instant(capture, plan, frame, store)).image)
        write_image(frame_path(folder, frame), image)
        seconds.append(time.perf_counter() - begun_s)
        if seconds[-1] > SLOW_S:
            break
    for frame in frames[len(seconds) :]:  # scoring is tried on as many as of the others
        write_image(frame_path(folder, frame), image)
    usual_s = seconds[-1] + (setup_s / len(frames) if isinstance(method, LookaheadMethod) else 0.0)
    return max(setup_s + sum(seconds) - len(seconds) * usual_s, 0.0), usual_s


def _instant(capture: Capture, plan: SourcePlan, frame: int, store: DepthStore) -> Instant:
    stored = [(name, store.read(key, frame)) for name, key in plan.depth_keys.items()]
    views = [
        SourceView(capture.camera(name), capture.frame(name, frame), each.depth, each.confidence, plan.shares[name])
        for name, each in stored
    ]
    return Instant(frame, plan.target, tuple(views), capture.units_per_metre)


def _cover(capture: Capture, plan: SourcePlan, frame: int, store: DepthStore) -> None:
    """What a mask of what no source sees is made from: each source's depth in the target view."""
    near = NEAR_M * capture.units_per_metre
    for name, key in plan.depth_keys.items():
        depth = store.read(key, frame).depth
        splat([PixelGaussians(capture.camera(name), depth, np.ones((*depth.shape, 1), np.float32))], plan.target, near=near)


def _again(work: Callable[[], object]) -> float:
    """Seconds of the second time."""
    return [timed(work) for _ in range(2)][1]


def _usual(seconds: Sequence[float]) -> float:
    """Mean of all but the first, which pays for what is loaded once; 0 where there is none."""
    later = seconds[1:] or seconds
    return sum(later) / len(later) if later else 0.0


def _with_checks(job: DepthJob) -> tuple[DepthJob, ...]:
    return (job.unchecked, *job.checked_with)


def _cameras(job: DepthJob) -> tuple[str, ...]:
    return (job.camera_name, *job.partner_names)


def _key(capture: Capture, job: DepthJob, options: DepthOptions) -> str:
    return DepthStore.key(depth_spec(capture, job, options))


def _most_memory() -> float:
    """The most this process has held, bytes; the system counts KiB, macOS bytes."""
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(held if sys.platform == "darwin" else held * KIB)
