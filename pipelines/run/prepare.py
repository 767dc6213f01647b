"""Prepare: what every method needs of a capture under a protocol - truth frames, source views, depth, a camera path."""

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras, translated_path
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.path import CameraPath, open_path
from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.errors import CaptureError, ProtocolError
from ggvs_eval.files.images import resize, write_image
from ggvs_eval.geometry.sight import require_sight
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.offline.depth.fill_store import depth_spec, plan_depth, prepare_depth
from ggvs_eval.pipelines.run.disocclusion import write_disocclusions
from ggvs_eval.pipelines.run.frame_cache import cache_frames
from ggvs_eval.pipelines.run.path_depth import write_path_depth
from ggvs_eval.pipelines.run.score_path import write_path_record
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder, frame_path, missing_frames, read_json, write_json, write_text


@dataclass(frozen=True)
class SourcePlan:
    """How one target view is synthesised.

    Attributes:
        target: the camera to synthesise, at synthesis size.
        jobs: depth of each source camera, nearest first; the target takes no part in any of it.
        depth_keys: source camera -> key of its depth in the depth store.
        shares: source camera -> how far the choice counts on it, see `ChosenSource`.
    """

    target: Camera
    jobs: tuple[DepthJob, ...]
    depth_keys: dict[str, str]
    shares: dict[str, float]


@dataclass(frozen=True)
class Prepared:
    """A run folder that is ready to render into, and the plan behind it.

    Attributes:
        run: the folder.
        protocol: what is evaluated.
        capture: the capture at synthesis size, its frames read from the run folder.
        plans: test view -> how it is synthesised.
        path: poses of the camera path, each with its plan.
        path_frame: the instant at which the camera moves along the path.
        path_images: what a camera would have seen there; None where nobody knows.
    """

    run: RunFolder
    protocol: Protocol
    capture: Capture
    plans: dict[str, SourcePlan]
    path: tuple[SourcePlan, ...]
    path_frame: int
    path_images: ImageFrames | None

    @property
    def frames(self) -> range:
        """Frame numbers of the protocol."""
        return range(self.protocol.frames.start, self.protocol.frames.start + self.protocol.frames.count)


def prepare(
    root: Path, capture: Capture, protocol: Protocol, workers: Workers = 1, depth: DepthRunOptions | None = None
) -> Prepared:
    """Write protocol, capture record, truth frames and depth into a run folder; what is there is kept.

    Args:
        root: the run folder; made if absent.
        capture: the capture at its own size.
        protocol: what to evaluate.
        workers: where the work is done.
        depth: how depth is found; as the folder says, or the default.

    Raises:
        CaptureError: the capture is unreadable or lacks what the protocol asks for.
        ProtocolError: the folder belongs to another protocol or capture.
    """
    capture, run = fit_capture(capture, protocol), RunFolder(root)
    options = open_run(run, protocol, capture, depth)
    planned = plan(run, protocol, capture, options)
    prepared = replace(planned, capture=cache_frames(capture, wanted_frames(planned, options), run.root / "truth", workers))
    _write_path_truth(prepared)
    _prepare_depth(prepared, options, workers)
    if any(name.endswith("_disoccluded") for name in protocol.measurement.metrics):
        views = {view: (each.target, each.depth_keys) for view, each in prepared.plans.items()}
        write_disocclusions(prepared.capture, views, prepared.frames, run.depth, run.root / "disoccluded", workers)
    if prepared.path:
        poses = [(plan.target, plan.depth_keys) for plan in prepared.path]
        write_path_depth(prepared.capture, poses, prepared.path_frame, DepthStore(run.depth), run.path_depth)
    return prepared


def prepare_truth(root: Path, capture: Capture, protocol: Protocol, workers: Workers = 1) -> RunFolder:
    """Write protocol, capture record and truth frames of the test views into a run folder: what scoring alone needs.

    Args:
        root: the run folder; made if absent. `prepare` can go on with it.
        capture: the capture at its own size.
        protocol: what to evaluate.
        workers: where the work is done.

    Raises:
        CaptureError: the capture is unreadable or lacks what the protocol asks for.
        ProtocolError: the folder belongs to another protocol or capture.
    """
    capture, run = fit_capture(capture, protocol), RunFolder(root)
    _claim_folder(run, protocol, capture)
    frames = range(protocol.frames.start, protocol.frames.start + protocol.frames.count)
    cache_frames(capture, dict.fromkeys(protocol.views.test, frames), run.root / "truth", workers)
    return run


def fit_capture(capture: Capture, protocol: Protocol) -> Capture:
    """The capture at the protocol's size, after a check that it has the views and frames that are asked for."""
    absent = [name for name in protocol.views.test if name not in capture.camera_names]
    if absent:
        raise CaptureError(
            f"{capture.path}: protocol {protocol.name} tests {', '.join(absent)}, the capture has "
            f"{', '.join(capture.camera_names)}; choose another protocol or edit views.test"
        )
    wanted = protocol.frames.start + protocol.frames.count
    if wanted > capture.n_frames:
        raise CaptureError(
            f"{capture.path}: protocol {protocol.name} wants frames {protocol.frames.start}..{wanted - 1}, the capture has "
            f"{capture.n_frames}; lower frames.count"
        )
    synthesis = protocol.synthesis
    if synthesis.width:
        return capture.resized(synthesis.width, synthesis.height, synthesis.resize_filter)
    return capture


def plan(run: RunFolder, protocol: Protocol, capture: Capture, options: DepthOptions) -> Prepared:
    """Choose source cameras and depth partners of every test view and path pose.

    Raises:
        CameraError: fewer sources than the protocol wants, or sources that can show too little of a test view.
        DepthError: a source that no camera can be matched with.

    Reading:
        Shares are for targets that move. A test view stands still and its sources never change, so that all count whole: with the
        path's shares, nearest sources score up to 0.17 dB less and chosen ones 0.08 to 0.18 dB (validation rooms).
    """
    path = _camera_path(capture, protocol)
    targets = [*(capture.camera(view) for view in protocol.views.test), *path.cameras]
    k, choice = protocol.synthesis.k, protocol.synthesis.sources
    chosen = {target.name: choose_sources(target, capture.cameras, k, choice) for target in targets}
    sensed = capture.sensed_cameras if options.sensor is not None else frozenset[str]()
    for target in targets[: len(protocol.views.test)]:
        require_sight(target, [each.camera for each in chosen[target.name]], capture.cameras, sensed)
    jobs = plan_depth(capture, targets, k, options, choice)
    keys = {job: DepthStore.key(depth_spec(capture, job, options)) for sources in jobs.values() for job in sources.values()}
    plans = {
        target.name: SourcePlan(
            target,
            tuple(jobs[target.name].values()),
            {name: keys[job] for name, job in jobs[target.name].items()},
            {each.camera.name: each.share for each in chosen[target.name]},
        )
        for target in targets
    }
    views = {view: replace(plans[view], shares=dict.fromkeys(plans[view].shares, 1.0)) for view in protocol.views.test}
    frame = min(max(round(path.time_s * capture.fps), protocol.frames.start), capture.n_frames - 1)
    return Prepared(run, protocol, capture, views, tuple(plans[pose.name] for pose in path.cameras), frame, path.images)


def _camera_path(capture: Capture, protocol: Protocol) -> CameraPath:
    """The capture's own path where it has one, else a horizontal translation around the first test view.

    Reading:
        The paper moves the camera horizontally and does not say from where to where; ours spans the nearest cameras on both
        sides, at the protocol's first instant.
    """
    middle = capture.camera(protocol.views.test[0])
    if protocol.path.poses == 0:
        return CameraPath((), None, 0.0)
    known = open_path(capture.path)
    if known is not None and _shows_its_instant(capture, known):
        return replace(known, cameras=tuple(pose.resized(*middle.size) for pose in known.cameras))
    neighbour = nearest_cameras(middle, capture.cameras, 2)[-1]
    span = 2 * float(np.linalg.norm(neighbour.centre - middle.centre))
    return CameraPath(tuple(translated_path(middle, span, protocol.path.poses)), None, 0.0)


def _shows_its_instant(capture: Capture, known: CameraPath) -> bool:
    """Whether the capture's own path was rendered at an instant that can be seen: not where another one is held still."""
    edit = capture.edit
    return edit is None or not edit.hold_frames or round(known.time_s * capture.fps) == edit.hold_frame


def open_run(run: RunFolder, protocol: Protocol, capture: Capture, depth: DepthRunOptions | None) -> DepthOptions:
    """Make a folder this run's, or make sure that it already is, before anything is written into it.

    Args:
        run: the folder; made if absent.
        protocol: what is evaluated.
        capture: at synthesis size.
        depth: how depth is found; as the folder says, or the default.

    Raises:
        ProtocolError: the folder belongs to another protocol or capture, or its depth is found otherwise.
    """
    _claim_folder(run, protocol, capture)
    choice = depth_choice_of(run, depth)
    if not run.depth_record.is_file():
        write_json(run.depth_record, choice.record())
    return choice.options()


def _claim_folder(run: RunFolder, protocol: Protocol, capture: Capture) -> None:
    """Make the folder this run's, or make sure that it already is."""
    record = _capture_record(capture, run.root)
    if run.protocol_file.is_file() and (run.protocol(), run.capture_record()["digests"]) != (protocol, record["digests"]):
        raise ProtocolError(
            f"{run.root}: holds a run of another protocol or capture ({run.protocol().name}); choose a new folder or delete it"
        )
    run.root.mkdir(parents=True, exist_ok=True)
    write_json(run.root / "capture.json", record)
    write_text(run.protocol_file, protocol.to_toml())


def depth_choice_of(run: RunFolder, wanted: DepthRunOptions | None) -> DepthRunOptions:
    """How this folder's depth is found, or will be; methods of one table must have been given the same.

    Raises:
        ProtocolError: the folder's depth is found otherwise.
    """
    if not run.depth_record.is_file():
        return wanted or DepthRunOptions()
    known = DepthRunOptions.from_record(read_json(run.depth_record))
    if wanted not in (None, known):
        raise ProtocolError(
            f"{run.root}: holds a run whose depth is found by {known.options().matcher.name} ({run.depth_record.name}), wanted "
            f"{wanted}; choose a new folder or delete it"
        )
    return known


def _capture_record(capture: Capture, root: Path) -> dict[str, Any]:
    """What a run folder says of its capture: its path as it was given, and where it lies, seen from anywhere and from the run."""
    place = capture.path.resolve()
    cameras = {
        camera.name: {
            "K": camera.K.tolist(),
            "world_to_camera": camera.world_to_camera.tolist(),
            "size": list(camera.size),
            "near": camera.near,
            "far": camera.far,
        }
        for camera in capture.cameras
    }
    return {
        "path": str(capture.path),
        "place": {"absolute": str(place), "from_run": os.path.relpath(place, root.resolve())},
        "scene": capture.scene,
        "layout": capture.layout,
        "fps": capture.fps,
        "n_frames": capture.n_frames,
        "units_per_metre": capture.units_per_metre,
        "units_origin": capture.units_origin,
        "notes": list(capture.notes),
        "edit": capture.edit and asdict(capture.edit),
        "cameras": cameras,
        "digests": {name: capture.digest(name) for name in capture.camera_names},
    }


def wanted_frames(planned: Prepared, options: DepthOptions) -> dict[str, list[int]]:
    """Which frames of which cameras take part: test views, source cameras and those that their depth is matched with."""
    wanted: dict[str, list[int]] = {view: list(planned.frames) for view in planned.plans}
    first_needed = options.time.first_needed
    for_views = range(first_needed(planned.frames.start), planned.frames.stop)
    for_path = range(first_needed(planned.path_frame), planned.path_frame + 1)
    for plans, frames in ((planned.plans.values(), for_views), (planned.path, for_path)):
        for job in {job for plan in plans for job in plan.jobs}:
            for name in (job.camera_name, *job.partner_names):
                wanted[name] = sorted({*wanted.get(name, []), *frames})
    return wanted


def _write_path_truth(prepared: Prepared) -> None:
    """Write the path's images where the capture has them, and where its poses lie."""
    folder, images = prepared.run.path("truth"), prepared.path_images
    if images is not None and missing_frames(folder, range(images.n_frames)):
        size = prepared.path[0].target.size
        for pose, image in enumerate(images.frames(0, images.n_frames)):
            write_image(frame_path(folder, pose), resize(image, *size, prepared.protocol.synthesis.resize_filter))
    write_path_record(prepared.run, prepared.path_frame, [(plan.target, list(plan.depth_keys)) for plan in prepared.path])


def _prepare_depth(prepared: Prepared, options: DepthOptions, workers: Workers) -> None:
    """Estimate what the plans need: all frames for the test views, one instant for the path."""
    store = DepthStore(prepared.run.depth)
    views = {job for plan in prepared.plans.values() for job in plan.jobs}
    prepare_depth(prepared.capture, sorted(views), prepared.frames, store, options, workers)
    path = {job for plan in prepared.path for job in plan.jobs}  # its instant may lie outside the protocol's frames
    prepare_depth(prepared.capture, sorted(path), range(prepared.path_frame, prepared.path_frame + 1), store, options, workers)
