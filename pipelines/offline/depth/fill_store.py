"""Fill a depth store: every camera and instant that the online part will ask for."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ggvs_eval.camera import Camera, SourceChoice
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import listed
from ggvs_eval.depth_store import DepthJob, DepthMap, DepthStore, describe_depth
from ggvs_eval.depth_work import Instants, missing_depth
from ggvs_eval.errors import CameraError, DepthError
from ggvs_eval.geometry.source_views import ChosenSource, choose_sources
from ggvs_eval.jobs.engine import Workers, as_engine, run_all
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    ERROR_PX,
    DepthOptions,
    check_depth,
    check_measured_depth,
    finish,
)
from ggvs_eval.pipelines.offline.depth.colour_fill import describe_fill
from ggvs_eval.pipelines.offline.depth.consistency import describe_check
from ggvs_eval.pipelines.offline.depth.depth_stream import DepthStream
from ggvs_eval.pipelines.offline.depth.matchers import SharedMatches
from ggvs_eval.pipelines.offline.depth.sensor_and_stereo import (
    SENSORS,
    fill_by_sensor,
    partners_of_sensed,
)

Item = TypeVar("Item")
FILLED = "sensor"  # in a spec: the sensor that fills what stereo does not find
# cameras whose depth one process computes at once: it holds the maps of all their pairs
MOST_TOGETHER = 12


class DepthPartners:
    """Partners of each source, found once for each target that it must not be matched with."""

    def __init__(self, capture: Capture, options: DepthOptions) -> None:
        self.capture, self.options = capture, options
        self._found: dict[tuple[str, str | None], tuple[str, ...]] = {}
        # Near targets share jobs, whose specs take a digest of every frame source.
        self._jobs: dict[tuple[str, ...], DepthJob] = {}
        self.unmatched: dict[str, str] = {}  # camera that none can be matched with -> why

    def of(self, source: Camera, target: Camera | None = None) -> tuple[str, ...]:
        """The partners of a source, never the target.

        None if a sensor's depth is used alone, or where it is in `unmatched`.
        """
        left_out = target.name if target and target.name in self.capture.camera_names else None
        key = source.name, left_out
        if key not in self._found:
            is_sensed = _sensor(self.capture, source.name, self.options) is not None
            try:
                cameras, excluded = self.capture.cameras, () if left_out is None else (left_out,)
                if not is_sensed:
                    partners = self.options.choose_partners(source, cameras, excluded)
                else:
                    partners = (
                        partners_of_sensed(source, cameras, self.options, excluded)
                        if self.options.sensor_fills
                        else []
                    )
                self._found[key] = tuple(partner.name for partner in partners)
            except DepthError as error:
                self._found[key] = ()
                if not is_sensed:
                    self.unmatched.setdefault(source.name, str(error))
        return self._found[key]

    def has_depth(self, source: Camera, target: Camera | None = None) -> bool:
        """Return whether a source has depth where the target is left out."""
        return (
            bool(self.of(source, target))
            or _sensor(self.capture, source.name, self.options) is not None
        )

    def sources(
        self, target: Camera, k: int, how: SourceChoice = "nearest"
    ) -> tuple[ChosenSource, ...]:
        """The K sources of a target: of those that have depth if there are enough, else as
        `choose_sources` takes them.
        """
        cameras: Sequence[Camera] = self.capture.cameras
        first = choices = choose_sources(target, cameras, k, how)
        while without := {
            source.camera.name for source in choices if not self.has_depth(source.camera, target)
        }:
            cameras = [camera for camera in cameras if camera.name not in without]
            try:
                choices = choose_sources(target, cameras, k, how)
            except CameraError:
                return first
        return choices

    def jobs(self, target: Camera, sources: Sequence[ChosenSource]) -> tuple[DepthJob, ...]:
        """Return the depth of the sources of a target, checked against each other.

        Unknown where nothing can be matched.
        """
        jobs, with_depth = {}, {}
        for source in sources:
            camera = source.camera
            names = (camera.name, *self.of(camera, target))
            if names not in self._jobs:
                self._jobs[names] = depth_job(self.capture, camera.name, names[1:], self.options)
            jobs[camera.name] = self._jobs[names]
            if self.has_depth(camera, target):
                with_depth[camera.name] = self._jobs[names]
        return tuple(
            _checked(job, with_depth, self.options) if name in with_depth else job
            for name, job in jobs.items()
        )

    def describe_unmatched(self) -> str:
        """Return one line that names all cameras without depth, and why.

        Empty if there are none.
        """
        if not self.unmatched:
            return ""
        reason = next(iter(self.unmatched.values())).partition(": ")[2]
        return f"no depth of {listed(list(self.unmatched))}: {reason}"


def plan_depth(
    capture: Capture,
    targets: Sequence[Camera],
    k: int,
    options: DepthOptions,
    sources: SourceChoice = "nearest",
) -> dict[str, dict[str, DepthJob]]:
    """Plan the depth that each target needs: of its k sources, matched with any camera but the
    target.

    Args:
        targets: cameras to be rendered, of the capture (left out of everything) or of a virtual
            path.

    Returns:
        For each target's name its sources' names, nearest first, each with its job and that job's
        key; equal jobs are shared between targets.
    """
    partners = DepthPartners(capture, options)
    plan = {}
    for target in targets:
        jobs = partners.jobs(target, partners.sources(target, k, sources))
        plan[target.name] = {job.camera_name: job for job in jobs}
    return plan


def plan_rig_depth(capture: Capture, options: DepthOptions) -> tuple[DepthJob, ...]:
    """Plan the depth of the cameras of a capture, matched with the others and checked against the
    cameras it is matched with.

    Returns:
        One job per camera that another can be matched with, in the order of the capture.
    """
    partners = DepthPartners(capture, options)
    names = [
        (camera.name, *partners.of(camera))
        for camera in capture.cameras
        if partners.has_depth(camera)
    ]
    if not names:
        raise DepthError(f"{capture.path}: {partners.describe_unmatched()}")
    jobs = {group[0]: depth_job(capture, group[0], group[1:], options) for group in names}
    return tuple(
        _checked(
            jobs[name],
            {partner: jobs[partner] for partner in (name, *matched) if partner in jobs},
            options,
        )
        for name, *matched in names
    )


def without_unmatched(capture: Capture, options: DepthOptions) -> Capture:
    """Return the capture without cameras that no other can be matched with, which a note names."""
    partners = DepthPartners(capture, options)
    lost = [camera.name for camera in capture.cameras if not partners.has_depth(camera)]
    if len(lost) == len(capture.cameras):
        raise DepthError(f"{capture.path}: {partners.describe_unmatched()}")
    return capture.without(lost, partners.describe_unmatched())


def _checked(
    job: DepthJob, jobs_by_source: Mapping[str, DepthJob], options: DepthOptions
) -> DepthJob:
    """Return a source's depth checked against the view's other sources.

    In the order of names, so that near targets share it.
    """
    partners = tuple(
        jobs_by_source[name] for name in sorted(jobs_by_source) if name != job.camera_name
    )
    if not options.consistency or not partners:
        return job
    described = describe_check()
    if options.sensor and not job.partner_names:
        described |= {"fill": describe_fill()}
    return job.checked_against(partners, described)


def _sensor(capture: Capture, name: str, options: DepthOptions) -> Any:
    """Return the filter of the depth that a sensor measured.

    None if there is no such depth or it is not wanted.
    """
    source = capture.extras_of(name).depth if options.sensor else None
    return None if source is None else SENSORS["sensor depth"](capture.camera(name), source)


def _filled(
    capture: Capture, job: DepthJob, frame: int, depth_map: DepthMap, options: DepthOptions
) -> DepthMap:
    """Return what stereo found, filled by what a sensor measured where the job says so."""
    if FILLED not in job.spec or (sensor := _sensor(capture, job.camera_name, options)) is None:
        return depth_map
    image = capture.frame(job.camera_name, frame)
    return fill_by_sensor(depth_map, sensor.at(frame, image), image)


def depth_job(
    capture: Capture, camera_name: str, partner_names: Sequence[str], options: DepthOptions
) -> DepthJob:
    """Return a job with all that its depth depends on, as it is found.

    Args:
        partner_names: the cameras it is matched with; none if a sensor alone measured its depth, or
            nothing did.
    """
    names = (camera_name, *partner_names)
    camera, *partners = (capture.camera(name) for name in names)
    sensor = (
        None if partners and not options.sensor_fills else _sensor(capture, camera_name, options)
    )
    described = (options if partners or sensor is None else sensor).describe() | {
        "resize_filter": capture.resize_filter
    }
    spec = describe_depth(
        camera, partners, {name: capture.digest(name) for name in names}, described
    )
    if partners and sensor is not None:
        spec[FILLED] = sensor.describe() | {"fill": describe_fill()}
    return DepthJob(camera_name, tuple(partner_names), spec=spec)


def prepare_depth(
    capture: Capture,
    jobs: Sequence[DepthJob],
    frames: Sequence[int],
    store: DepthStore,
    options: DepthOptions,
    workers: Workers,
) -> None:
    """Compute the depth of every job and frame that the store does not have.

    Jobs run side by side, one process each, frames as a stream. A killed run continues where it
    stopped; the result depends neither on the number of workers nor on where they are.

    Args:
        jobs: what to compute, see `plan_depth`; equal jobs are computed once.
        frames: instants, ascending.
    """
    uncomputed, checked = missing_depth(jobs, frames, store)
    if options.matcher.rig and options.keyframe_every == 1:
        _share_pairs(capture, uncomputed, store, options, workers)
        uncomputed, _ = missing_depth(jobs, frames, store)
    groups = _by_camera(uncomputed, options, as_engine(workers).jobs)
    run_all(partial(_run, capture, store, options), groups, workers, "depth maps per camera")
    run_all(
        partial(_check, capture, store, options),
        [*checked.items()],
        workers,
        "depth checked against other cameras",
    )


def _by_camera(needed: Instants, options: DepthOptions, processes: int) -> list[Instants]:
    """Jobs that match one camera together, so that they share its pairs.

    Each alone where instants depend on each other.

    So are they where there are more processes than cameras: they would wait.
    """
    groups: dict[str, dict[DepthJob, Sequence[int]]] = {}
    for job, frames in needed.items():
        groups.setdefault(job.camera_name if job.partner_names else job.key, {})[job] = frames
    shares = options.keyframe_every == 1 and len(groups) >= processes
    return list(groups.values()) if shares else [{job: frames} for job, frames in needed.items()]


def _share_pairs(
    capture: Capture, needed: Instants, store: DepthStore, options: DepthOptions, workers: Workers
) -> None:
    """Do the jobs that match cameras, together, so that they share their pairs.

    Each process takes some of the instants.
    """
    # by name: neighbours mostly are each other's partners
    ordered = sorted(job for job in needed if job.partner_names)
    if not ordered:
        return
    frames, processes = (
        sorted(set().union(*(needed[job] for job in ordered))),
        as_engine(workers).jobs,
    )
    groups = max(-(-len(ordered) // MOST_TOGETHER), min(-(-processes // len(frames)), len(ordered)))
    spans = min(-(-processes // groups), len(frames))
    items = [
        {job: [frame for frame in needed[job] if frame in span] for job in group}
        for span in map(set, _split(frames, spans))
        for group in _split(ordered, groups)
    ]
    run_all(
        partial(_run_together, capture, store, options),
        items,
        workers,
        "depth maps of single cameras and instants",
    )


def _split(items: Sequence[Item], parts: int) -> list[Sequence[Item]]:
    return [items[len(items) * n // parts : len(items) * (n + 1) // parts] for n in range(parts)]


def _run_together(
    capture: Capture, store: DepthStore, options: DepthOptions, needed: Instants
) -> None:
    """Compute some jobs at some instants, each pair of cameras matched once; runs in a worker."""
    missing = {job: _lacking(store, job, frames) for job, frames in needed.items()}
    instants = set().union(*missing.values())
    if not instants or options.matcher.rig is None:
        return
    matched = [(job.camera_name, *job.partner_names) for job in missing]
    names = list(dict.fromkeys(name for group in matched for name in group))
    rig = options.matcher.rig([capture.camera(name) for name in names], matched, ERROR_PX)
    start, stop = min(instants), max(instants) + 1
    decoded = [capture.frames(name, start, stop) for name in names]
    for frame, images in zip(range(start, stop), zip(*decoded, strict=True), strict=True):
        if frame not in instants:
            continue
        for job, depth_map in zip(
            missing, rig.estimate(dict(zip(names, images, strict=True))), strict=True
        ):
            if frame in missing[job]:
                store.write(
                    job.key,
                    frame,
                    _filled(capture, job, frame, finish(depth_map, options), options),
                )


def _lacking(store: DepthStore, job: DepthJob, frames: Sequence[int]) -> list[int]:
    """Open the folder of a job, and return the instants that another process has not written
    meanwhile.
    """
    key = store.write_spec(job.spec)
    return [frame for frame in frames if not store.has(key, frame)]


def _check(
    capture: Capture, store: DepthStore, options: DepthOptions, item: tuple[DepthJob, Sequence[int]]
) -> None:
    """Check one camera's depth against the others; runs in a worker."""
    job, frames = item
    key = store.write_spec(job.spec)
    job_key, *partner_keys = (
        (map_job.camera_name, map_job.key) for map_job in (job.unchecked, *job.checked_with)
    )
    for frame in frames:
        if store.has(key, frame):
            continue  # by another process, which may have dropped what it was checked against
        views = [
            (capture.camera(name), store.read(partner_key, frame))
            for name, partner_key in partner_keys
        ]
        camera, depth_map = capture.camera(job_key[0]), store.read(job_key[1], frame)
        if job.partner_names:
            # whatever the share of gaps
            check_options = replace(options, filler_share=0.0) if FILLED in job.spec else options
            checked = check_depth(camera, depth_map, views, check_options)
        else:
            checked = check_measured_depth(
                camera, capture.frame(camera.name, frame), depth_map, views, options
            )
        store.write(key, frame, checked)


def _run(capture: Capture, store: DepthStore, options: DepthOptions, needed: Instants) -> None:
    """Compute frames of jobs of one camera, each partner matched once an instant.

    Runs in a worker.
    """
    missing = {job: _lacking(store, job, frames) for job, frames in needed.items()}
    jobs, instants = [*missing], set().union(*missing.values())
    if not instants:
        return
    camera = capture.camera(jobs[0].camera_name)
    if not jobs[0].partner_names:
        sensor = _sensor(capture, camera.name, options)
        for frame in sorted(instants):
            zeros = np.zeros((2, camera.height, camera.width), np.float32)
            depth_map = (
                sensor.at(frame, capture.frame(camera.name, frame)) if sensor else DepthMap(*zeros)
            )
            store.write(jobs[0].key, frame, depth_map)
        return
    shared: SharedMatches | None = {} if len(jobs) > 1 else None
    streams = {
        job: DepthStream(
            camera=camera,
            partners=[capture.camera(name) for name in job.partner_names],
            options=options,
            shared=shared,
        )
        for job in jobs
    }
    names = list(
        dict.fromkeys([camera.name, *(name for job in jobs for name in job.partner_names)])
    )
    start, stop = options.first_needed(min(instants)), max(instants) + 1
    decoded = [capture.frames(name, start, stop) for name in names]
    for frame, pictures in zip(range(start, stop), zip(*decoded, strict=True), strict=True):
        images = dict(zip(names, pictures, strict=True))
        if shared is not None:
            shared.clear()
        for job, stream in streams.items():
            if options.keyframe_every > 1 or frame in missing[job]:
                depth_map = stream.step(
                    frame, images[camera.name], [images[name] for name in job.partner_names]
                )
                if frame in missing[job]:
                    store.write(job.key, frame, _filled(capture, job, frame, depth_map, options))
