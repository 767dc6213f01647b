"""The plan of a run: the request, and everything that follows from it before anything is written.

A plan is made once. What is left to do is counted on it, and prepare, render and score work through it.
"""

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from typing import Protocol as Door

import numpy as np

from ggvs_eval import built_in
from ggvs_eval.camera import Camera, nearest_cameras, translated_path
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import listed
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.llff import CameraPath, open_path
from ggvs_eval.depth_options import DEVICE, UNEXPLAINED, DepthRunOptions, default_matcher
from ggvs_eval.depth_store import DepthJob
from ggvs_eval.errors import CameraError, CaptureError, DepthError, GgvsWarning, ProtocolError
from ggvs_eval.geometry.sight import require_sight
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.methods.fitted import FittedMethod
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions, checked_device
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.methods.render_unit import PATH, RenderUnit, SourcePlan
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.fill_store import DepthPartners, plan_depth
from ggvs_eval.pipelines.offline.depth.sensor_and_stereo import unexplained
from ggvs_eval.pipelines.run.claim import require_owner
from ggvs_eval.pipelines.run.derived_files import cached_capture
from ggvs_eval.pipelines.run.folds import FitPlan, fill_folds, plan_fits, plan_folds, visible_cameras
from ggvs_eval.pipelines.run.render import RunJobs, fit_job, render_job
from ggvs_eval.plugins import Registry
from ggvs_eval.progress import counted
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder, read_json

TRUTH_BYTES = 2.1  # per pixel, PNG of frames with and without sensor noise as on the demo


def choose_path(capture: Capture, protocol: Protocol) -> CameraPath:
    """Return the protocol's poses, else the capture's own path where it has one, else a translation around the first test view.

    Returns:
        Poses at the size of a test view; none if the protocol wants none.

    Reading:
        The paper moves the camera horizontally and does not say from where to where; this one spans the nearest cameras on both
        sides, at the protocol's first instant.
    """
    middle = capture.camera(protocol.views.test[0])
    if protocol.path.poses == 0:
        return CameraPath((), None, 0.0)
    if protocol.path.cameras:
        poses = (Camera.from_json(f"path{index:04d}", asdict(pose)) for index, pose in enumerate(protocol.path.cameras))
        return CameraPath(tuple(pose.resized(*middle.size) for pose in poses), None, 0.0)
    own_path, edit = open_path(capture.path), capture.edit
    held = edit.hold_frame if edit and edit.hold_frames else None  # the one instant that can be seen
    if own_path is not None and held in (None, round(own_path.time_s * capture.fps)):
        return replace(own_path, cameras=tuple(pose.resized(*middle.size) for pose in own_path.cameras))
    neighbour = nearest_cameras(middle, capture.cameras, 2)[-1]
    span = 2 * float(np.linalg.norm(neighbour.centre - middle.centre))
    return CameraPath(tuple(translated_path(middle, span, protocol.path.poses)), None, 0.0)


# What a refusal for want of depth adds.
WITHOUT_DEPTH = "methods without depth, such as enerf and ibrnet, still run"


@dataclass(frozen=True)
class RunRequest:
    """User request for a run.

    Attributes:
        labels: methods; none if it is only prepared.
        depth: how depth is found; as the folder says, or the default.
        shared: folder whose truth/ and depth/ it uses together with others; its own where None.
        views: units of a shard, test views or ``path``; None for all, none if the run is only prepared.
        imports: label -> renders of others, which become a method of the run.
        name: of the run in a sweep, for people.
    """

    root: Path
    capture: Capture
    protocol: Protocol
    labels: Sequence[str] = ()
    depth: DepthRunOptions | None = None
    networks: NetworkOptions = field(default_factory=lambda: AS_SHIPPED)
    shared: Path | None = None
    views: Collection[str] | None = None
    imports: Mapping[str, Path] = field(default_factory=dict)
    name: str = ""

    @property
    def only_prepares(self) -> bool:
        """True if nothing of it is rendered."""
        return self.views is not None and not self.views


@dataclass(frozen=True)
class Piece:
    """A part of the remaining work: files that are missing in one folder, or a scene to fit.

    Attributes:
        kind: see `ggvs_eval.pipelines.methods.stage_costs.stage_of`.
        folder: where they will be; runs that share it have the piece in common.
        label: of the method that renders them.
        core_seconds: of all of them at `pace` 1; None if they are not known.
        passing: they are removed before anything is rendered.
    """

    kind: str
    folder: Path
    count: int
    n_bytes: float = 0.0
    label: str = ""
    core_seconds: float | None = None
    passing: bool = False


@dataclass(frozen=True)
class RunPlan:
    """A run as it will be made, or as it has been prepared.

    Attributes:
        request: what it was made of.
        depth_device: where a network computes that finds it; ``cpu`` where none does.
        original: the capture at synthesis size, its frames as they are on disk.
        plans: test view -> how it is synthesised.
        path: poses of the camera path, each with its plan.
        path_frame: the instant at which the camera moves along the path.
        path_images: what a camera would have seen there; None if that is unknown.
        fits: of the methods that are fitted; none if no such method is wanted.
        compared: by what depth of sensors was chosen, for the record of depth; empty where nothing was compared.
    """

    request: RunRequest
    run: RunFolder
    methods: Mapping[str, MethodSpec]
    depth: DepthRunOptions
    depth_device: str
    original: Capture
    plans: dict[str, SourcePlan]
    path: tuple[SourcePlan, ...]
    path_frame: int
    path_images: ImageFrames | None
    fits: tuple[FitPlan, ...] = ()
    compared: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the run in a sweep; empty for a single run."""
        return self.request.name

    @property
    def protocol(self) -> Protocol:
        """Protocol of the evaluation."""
        return self.request.protocol

    @cached_property
    def capture(self) -> Capture:
        """The capture at synthesis size, its frames read from the run folder: there they are once it is prepared."""
        return cached_capture(self.original, self.frames_of_cameras(), self.run.root / "truth")

    @cached_property
    def jobs(self) -> RunJobs:
        """All render jobs of the request, assuming that preparation is done.

        Raises:
            DeviceError: no such device here.
            RenderError: a method that cannot be made, or one that is fitted and that the run was planned without.
            WeightsError: a method lacks its weights, or they are not its own.
        """
        for spec in self.methods.values():
            spec.require()  # what is missing shows before anything is rendered
        fits, renders = [], []
        for label, spec in self.methods.items():
            scenes = (
                []
                if not isinstance(spec, FittedMethod)
                else [fit_job(self.capture, fit, spec, self.shared_root) for fit in self.fits if fit.label == label]
            )
            entries = {unit: job.entry for job in scenes for unit in job.units}
            fits += scenes
            units = [replace(unit, fit=entries.get(unit.name)) for unit in self.units]
            renders += [render_job(self.run, label, spec, unit) for unit in units]
        # What waits for no fit first, and the longest first, so that all workers end at about the same time.
        of_path_first = len(self.path) > len(self.frames)
        fitted = {job.label for job in fits}
        renders.sort(key=lambda job: (job.label in fitted, (job.units == (PATH,)) != of_path_first))
        return RunJobs(tuple(fits), tuple(renders)).of_units(self.request.views)

    def rendered_labels(self) -> list[str]:
        """Return the methods whose test views are all rendered, as far as the request names them."""
        open_labels = {job.label for job in self.jobs.render if job.units != (PATH,) and not job.is_done()}
        return [label for label in self.methods if label not in open_labels]

    @property
    def units(self) -> list[RenderUnit]:
        """The test views, and the camera path if there is one."""
        plans = {view: (plan,) for view, plan in self.plans.items()} | ({PATH: self.path} if self.path else {})
        return [
            RenderUnit(name, of_unit, self.frames, self.path_frame, self.capture, self.run.depth)
            for name, of_unit in plans.items()
        ]

    @property
    def depth_options(self) -> DepthOptions:
        """The parameters of depth."""
        return self.depth.options(self.depth_device)

    @property
    def shared_root(self) -> Path:
        """Folder of the captured frames and of the depth store."""
        return self.request.shared or self.run.root

    @property
    def frames(self) -> range:
        """Frame numbers of the protocol."""
        return self.protocol.frames.numbers

    @property
    def path_frames(self) -> range:
        """The instant of the path, which may be outside the protocol's frames."""
        return range(self.path_frame, self.path_frame + 1)

    def depth_work(self) -> list[tuple[list[DepthJob], Sequence[int]]]:
        """Jobs of depth with their instants, for views, path and fits; maps that are wanted for several are in each."""
        of_views, of_path = (self.view_jobs, self.frames), (self.path_jobs, self.path_frames)
        of_fits = {(fit.fold.name, fit.depth_indices): fit for fit in self.fits}
        return [of_views, of_path, *((list(fit.fold.jobs), fit.depth_indices) for fit in of_fits.values() if fit.depth_indices)]

    @property
    def view_jobs(self) -> list[DepthJob]:
        """Depth that the test views need, each once."""
        return sorted({job for plan in self.plans.values() for job in plan.jobs})

    @property
    def path_jobs(self) -> list[DepthJob]:
        """Depth that the camera path needs, each once."""
        return sorted({job for plan in self.path for job in plan.jobs})

    def piece(
        self,
        kind: str,
        folder: Path,
        count: int,
        cost: float | None,
        pixel_bytes: float = 0.0,
        label: str = "",
        passing: bool = False,
    ) -> Piece:
        """Return work that is left in one folder.

        Args:
            cost: core-seconds per megapixel of each file at `pace` 1; None if it is not known.
            pixel_bytes: bytes per pixel of each.
        """
        width, height = self.original.cameras[0].size
        n_pixels = count * width * height
        seconds = None if cost is None else n_pixels / 1e6 * cost
        return Piece(kind, folder, count, n_pixels * pixel_bytes, label, seconds, passing)

    def frames_of_cameras(self) -> dict[str, list[int]]:
        """Frames of each camera that take part: test views, source cameras and those that their depth is matched with."""
        numbers: dict[str, list[int]] = {view: list(self.frames) for view in self.plans}
        for jobs, frames in self.depth_work():
            needed = {*frames, *range(self.depth_options.first_needed(frames[0]), frames[0])}
            for name in {name for job in jobs for name in (job.camera_name, *job.partner_names)}:
                numbers[name] = sorted({*numbers.get(name, []), *needed})
        for fit in self.fits:
            for name in fit.fold.cameras:
                numbers[name] = sorted({*numbers.get(name, []), *fit.indices})
        return numbers


class Preparation(Door):
    """Something that runs need before they are rendered, besides captured frames and depth; each is a module."""

    def complete(self, plan: RunPlan, /) -> RunPlan:
        """Return the plan with what it adds to it."""

    def work_left(self, plan: RunPlan, /) -> list[Piece]:
        """List what `prepare` would make."""

    def prepare(self, plan: RunPlan, workers: Workers, /) -> None:
        """Make what is missing, when frames and depth are there."""


PREPARATIONS: Registry[Preparation] = Registry("preparations", built_in.PREPARATIONS)


def plan_run(request: RunRequest) -> RunPlan:
    """Choose source cameras and depth partners of every test view and path pose; nothing is written.

    Raises:
        CaptureError: the capture lacks what the protocol asks for.
        CameraError: fewer sources than the protocol wants, or sources that can show too little of a test view.
        DepthError: a view none of whose sources has depth, where a method wants it.
        DeviceError: depth is learned, and there is no such device.
        ProtocolError: the folder's depth is found otherwise, or it holds a run of another protocol or capture.

    Reading:
        Shares are for targets that move. A test view is static and its sources never change, so that all count whole: with the
        path's shares, nearest sources score up to 0.17 dB less and chosen ones 0.08 to 0.18 dB (validation rooms).
    """
    run, methods = RunFolder(request.root), {label: find_method(label, request.networks) for label in request.labels}
    fitted = {label: spec for label, spec in methods.items() if isinstance(spec, FittedMethod)}
    use_depth = any(spec.uses_depth for spec in methods.values())
    request = replace(
        request, protocol=_state_folds(request.protocol.over(request.capture.n_frames), run, request.capture, bool(fitted))
    )
    protocol = request.protocol
    capture, (depth, device, compared) = fit_capture(request.capture, protocol), _depth_of(run, request)
    require_owner(run, protocol, capture)
    visible, path = visible_cameras(capture, protocol), choose_path(capture, protocol)
    if depth.sensor == "compare" and visible.sensed_cameras and use_depth:
        depth, compared = _use_sensors(depth, visible, protocol, device)
    if UNEXPLAINED in compared:
        how, words = "where stereo finds none" if depth.sensor == "fill" else "alone", "of other cameras' pictures unexplained"
        sensor, stereo = compared[UNEXPLAINED]
        capture = capture.noted(f"sensors' depth is used {how}: it leaves {sensor:.1f} levels {words}, stereo's {stereo:.1f}")
    options = depth.options(device)
    targets = [*(capture.camera(view) for view in protocol.views.test), *path.cameras]
    k, choice = protocol.synthesis.k, protocol.synthesis.sources
    partners = DepthPartners(visible, options)
    chosen = {target.name: partners.sources(target, k, choice) for target in targets}
    sensed = visible.sensed_cameras if options.sensor else frozenset[str]()
    if sensed and not options.sensor_fills and depth.matcher != default_matcher():
        words = f"--matcher {depth.matcher} has no effect on {counted(len(sensed), 'camera')} whose depth is measured or given"
        warnings.warn(f"{capture.path}: {words}; use it with --sensor fill or --sensor no", GgvsWarning, stacklevel=2)
    unseen: dict[str, CameraError] = {}
    for target in targets[: len(protocol.views.test)] if use_depth or not methods else []:
        try:
            require_sight(target, [each.camera for each in chosen[target.name]], visible.cameras, sensed)
        except CameraError as error:
            unseen[target.name] = error
    if unseen:
        (_, first), *others = unseen.items()
        more = f"; the same holds for {listed(name for name, _ in others)}" if others else ""
        raise CameraError(f"{first}{more}; {WITHOUT_DEPTH}") from first
    blind = [
        target.name for target in targets if not any(partners.has_depth(each.camera, target) for each in chosen[target.name])
    ]
    if blind and use_depth:
        raise DepthError(
            f"{capture.path}: no source of {listed(blind)} has depth; {partners.describe_unmatched()}; {WITHOUT_DEPTH}"
        )
    if partners.unmatched:
        capture = capture.noted(partners.describe_unmatched())
    jobs = plan_depth(visible, targets, k, options, choice, partners)
    plans = {
        target.name: SourcePlan(
            target,
            tuple(jobs[target.name].values()),
            {each.camera.name: each.share for each in chosen[target.name]},
        )
        for target in targets
    }
    views = {view: replace(plans[view], shares=dict.fromkeys(plans[view].shares, 1.0)) for view in protocol.views.test}
    chosen_frame = protocol.path.frame if protocol.path.cameras else round(path.time_s * capture.fps)
    frame = min(max(chosen_frame, protocol.frames.start), capture.n_frames - 1)
    poses = tuple(plans[pose.name] for pose in path.cameras)
    plan = RunPlan(request, run, methods, depth, device, capture, views, poses, frame, path.images, compared=compared)
    if not fitted:
        return plan
    folds = plan_folds(visible, protocol.views.folds, bool(poses), options)
    return replace(plan, fits=plan_fits(fitted, folds, plan.frames, frame))


def _state_folds(protocol: Protocol, run: RunFolder, capture: Capture, is_needed: bool) -> Protocol:
    """Return the protocol with the folds that its run folder states, or with those by rule where a fitted method needs them."""
    if not protocol.views.folds and run.protocol_file.is_file() and (kept := run.protocol()).agrees_with(protocol):
        protocol = kept
    return fill_folds(protocol, fit_capture(capture, protocol)) if is_needed else protocol


def fit_capture(capture: Capture, protocol: Protocol) -> Capture:
    """Return the capture at the protocol's size."""
    for doing, names, key in (("tests", protocol.views.test, "test"), ("shows", protocol.views.sources, "sources")):
        absent = [name for name in names if name not in capture.camera_names]
        if absent:
            raise CaptureError(
                f"{capture.path}: protocol {protocol.name} {doing} {', '.join(absent)}, got "
                f"{', '.join(capture.camera_names)}; choose another protocol or edit views.{key}"
            )
    frames = protocol.frames.numbers
    if frames.stop > capture.n_frames:
        raise CaptureError(
            f"{capture.path}: protocol {protocol.name} wanted frames {frames.start}..{frames.stop - 1}, got "
            f"{capture.n_frames}; lower frames.count"
        )
    synthesis = protocol.synthesis
    if synthesis.width:
        return capture.resized(synthesis.width, synthesis.height, synthesis.resize_filter)
    return capture


def _use_sensors(
    depth: DepthRunOptions, capture: Capture, protocol: Protocol, device: str
) -> tuple[DepthRunOptions, dict[str, Any]]:
    """Choose how depth of sensors is used, by what explains the pictures of other cameras; test views are not asked.

    Depth that the user gave is used as it is, and so is a sensor's where nothing can be compared.
    """
    asked = tuple(name for name in capture.camera_names if name not in protocol.views.test)
    compared = None if capture.given_depth else unexplained(capture, asked, depth.options(device), protocol.frames.start)
    fills = compared is not None and compared[1] < compared[0]
    return replace(depth, sensor="fill" if fills else "alone"), {UNEXPLAINED: list(compared)} if compared else {}


def _depth_of(run: RunFolder, request: RunRequest) -> tuple[DepthRunOptions, str, dict[str, Any]]:
    """Return how this folder's depth is found, or will be, on which device, and by what it was chosen.

    Methods of one table must be given the same.

    Reading:
        Learned depth stays on the device that found its first map, regardless of the device of later calls: else a run that
        was prepared on a GPU would be prepared again where it is looked at. That device is missed only where a map is.
    """
    asked = request.depth
    if not run.depth_record.is_file():
        asked = asked or DepthRunOptions()
        return asked, checked_device(request.networks.device) if asked.is_learned else "cpu", {}
    values = read_json(run.depth_record)
    record = DepthRunOptions.from_record(values)
    if asked not in (None, record, replace(record, sensor="compare")):
        raise ProtocolError(
            f"{run.root}: holds a run whose depth is found by {record.options().matcher.name} ({run.depth_record.name}), wanted "
            f"{asked}; choose a new folder"
        )
    return record, values.get(DEVICE, "cpu"), {name: values[name] for name in values if name == UNEXPLAINED}
