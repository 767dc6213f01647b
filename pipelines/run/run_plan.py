"""The plan of a run: the request, and everything that follows from it before anything is written.

A plan is made once. What is left to do is counted on it, and prepare, render and score work through
it.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from typing import Protocol as Door

from ggvs_eval import built_in
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.depth_work import depth_tasks
from ggvs_eval.errors import AbsentPartError, CaptureError
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.methods.render_unit import PATH, RenderUnit, SourcePlan
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.pipelines.methods.stage_costs import COSTS, N_BYTES, render_cost
from ggvs_eval.pipelines.run.claim import require_owner
from ggvs_eval.pipelines.run.depth_of_run import DepthProvider, depth_of_run
from ggvs_eval.pipelines.run.derived_files import cached_capture, frame_tasks
from ggvs_eval.pipelines.run.render import SceneFit, UnitTask, render_task
from ggvs_eval.plugins import Registry
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.tasks.task import AnyTask, FileTask, Task


@dataclass(frozen=True)
class RunRequest:
    """User request for a run.

    Attributes:
        labels: methods; none if it is only prepared.
        depth: how depth is found; as the folder says, or the default.
        shared: folder whose truth/ and depth/ it uses together with others; its own where None.
        views: units of a shard, test views or ``path``; None for all, none if the run is only
            prepared.
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
class RunPlan:
    """A run as it will be made, or as it has been prepared.

    Attributes:
        request: what it was made of.
        depth: of the sources.
        original: the capture at synthesis size, its frames as they are on disk.
        plans: test view -> how it is synthesised.
        path: poses of the camera path, each with its plan.
        path_frame: the instant at which the camera moves along the path.
        path_images: what a camera would have seen there; None if that is unknown.
        fits: of the methods that are fitted; none if no such method is wanted.
        calibration: of the cameras, as workers do it; None if they are used as given.
    """

    request: RunRequest
    run: RunFolder
    methods: Mapping[str, MethodSpec]
    depth: DepthProvider
    original: Capture
    plans: dict[str, SourcePlan]
    path: tuple[SourcePlan, ...] = ()
    path_frame: int = 0
    path_images: ImageFrames | None = None
    fits: tuple[SceneFit, ...] = ()
    calibration: Callable[[Workers], Task] | None = None

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
        """The capture at synthesis size, its frames read from the run folder: there they are once
        it is prepared.
        """
        return cached_capture(self.original, self.frames_of_cameras(), self.run.root / "truth")

    @cached_property
    def renders(self) -> tuple[UnitTask, ...]:
        """What renders each unit by each method.

        What waits for no fit first, and the longest of these.

        Raises:
            DeviceError: no such device here.
            RenderError: a method that cannot be made, or one that is fitted and that the run was
                planned without.
            WeightsError: a method lacks its weights, or they are not its own.
        """
        for spec in self.methods.values():
            spec.require()  # what is missing shows before anything is rendered
        fits = {(fit.label, unit): fit for fit in self.fit_tasks for unit in fit.units}
        renders = []
        for label, spec in self.methods.items():
            for unit in self.units:
                fit = fits.get((label, unit.name))
                of_fit = replace(unit, fit=fit.made if fit else None)
                renders.append(self._priced(render_task(self.run, label, spec, of_fit, fit)))
        # All workers end at about the same time where the longest begin.
        of_path_first = len(self.path) > len(self.frames)
        renders.sort(
            key=lambda render: (bool(render.needs), (render.unit == PATH) != of_path_first)
        )
        views = self.request.views
        return tuple(render for render in renders if views is None or render.unit in views)

    @property
    def fit_tasks(self) -> list[UnitTask]:
        """What fits the scenes, one per method and fold."""
        return [fit.task(self.capture, self.shared_root) for fit in self.fits]

    @property
    def tasks(self) -> list[AnyTask]:
        """Everything that is made before renders are scored, in the order in which it is made."""
        calibrations = [self.calibration(1)] if self.calibration else []
        frames = frame_tasks(self.original, self.frames_of_cameras(), self.shared_root / "truth")
        prepared = [
            task
            for preparation in PREPARATIONS.built_in().values()
            for task in preparation.tasks(self)
        ]
        return [
            *map(self._priced, (*calibrations, *frames, *self.depth_tasks(), *prepared)),
            *self.renders,
        ]

    def depth_tasks(self) -> list[FileTask]:
        """Return what makes the depth of views, path and fits."""
        instants: dict[DepthJob, set[int]] = {}
        for jobs, frames in self.depth_work():
            for job in jobs:
                instants.setdefault(job, set()).update(frames)
        store = DepthStore(self.shared_root / "depth")
        return [
            task
            for job, frames in instants.items()
            for task in depth_tasks([job], sorted(frames), store)
        ]

    def rendered_labels(self) -> list[str]:
        """Return the methods whose test views are all rendered, as far as the request names
        them.
        """
        open_labels = {
            render.label for render in self.renders if render.unit != PATH and not render.is_done()
        }
        return [label for label in self.methods if label not in open_labels]

    @property
    def units(self) -> list[RenderUnit]:
        """The test views, and the camera path if there is one."""
        plans = {view: (plan,) for view, plan in self.plans.items()} | (
            {PATH: self.path} if self.path else {}
        )
        return [
            RenderUnit(
                name=name,
                plans=of_unit,
                frames=self.frames,
                path_frame=self.path_frame,
                capture=self.capture,
                depths=self.run.depth,
            )
            for name, of_unit in plans.items()
        ]

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
        """Jobs of depth with their instants, for views, path and fits.

        Maps that are wanted for several are in each.
        """
        of_views, of_path = (self.view_jobs, self.frames), (self.path_jobs, self.path_frames)
        of_fits = dict.fromkeys(fit.depth for fit in self.fits)
        return [of_views, of_path, *((list(jobs), frames) for jobs, frames in of_fits if frames)]

    @property
    def view_jobs(self) -> list[DepthJob]:
        """Depth that the test views need, each once."""
        return sorted({job for plan in self.plans.values() for job in plan.jobs})

    @property
    def path_jobs(self) -> list[DepthJob]:
        """Depth that the camera path needs, each once."""
        return sorted({job for plan in self.path for job in plan.jobs})

    def _priced(self, task: AnyTask) -> Any:
        """Return a task with the costs of its kind, at the size of the run."""
        width, height = self.original.cameras[0].size
        costs = COSTS | {"depth": self.depth.cost}
        cost = (
            render_cost(task.pace)
            if task.kind in ("render", "path render")
            else costs.get(task.kind)
        )
        cost_s = None if cost is None else cost * width * height / 1e6
        n_bytes = N_BYTES.get(task.kind, 0.0) * width * height
        needs: Any = tuple(map(self._priced, task.needs))
        return replace(task, cost_s=cost_s, n_bytes=n_bytes, needs=needs)

    def frames_of_cameras(self) -> dict[str, list[int]]:
        """Frames of each camera that take part: test views, source cameras and those that their
        depth is matched with.
        """
        numbers: dict[str, list[int]] = {view: list(self.frames) for view in self.plans}
        for jobs, frames in self.depth_work():
            needed = {*frames, *range(self.depth.first_needed(frames[0]), frames[0])}
            for name in {name for job in jobs for name in (job.camera_name, *job.partner_names)}:
                numbers[name] = sorted({*numbers.get(name, []), *needed})
        for fit in self.fits:
            for name in fit.cameras:
                numbers[name] = sorted({*numbers.get(name, []), *fit.indices})
        return numbers


class Preparation(Door):
    """Something that runs need before they are rendered, besides captured frames and depth.

    Each is a module.
    """

    def complete(self, plan: RunPlan, /) -> RunPlan:
        """Return the plan with what it adds to it."""

    def tasks(self, plan: RunPlan, /) -> Sequence[AnyTask]:
        """Return what `prepare` makes, as far as it can be made without preparation."""

    def prepare(self, plan: RunPlan, workers: Workers, /) -> None:
        """Make what is missing, when frames and depth are there."""


CALIBRATIONS: Registry[Any] = Registry("calibration", built_in.CALIBRATIONS)
PREPARATIONS: Registry[Preparation] = Registry("preparations", built_in.PREPARATIONS)


def plan_run(request: RunRequest) -> RunPlan:
    """Choose source cameras and depth partners of every test view and path pose.

    Nothing is written.

    Raises:
        CaptureError: the capture lacks what the protocol asks for.
        CameraError: fewer sources than the protocol wants, or sources that can show too little of a
            test view.
        DepthError: a view none of whose sources has depth, where a method wants it.
        DeviceError: depth is learned, and there is no such device.
        ProtocolError: the folder's depth is found otherwise, or it holds a run of another protocol
            or capture.

    Reading:
        Shares are for targets that move. A test view is static and its sources never change, so
        that all count whole: with the path's shares, nearest sources score up to 0.17 dB less and
        chosen ones 0.08 to 0.18 dB (validation rooms).
    """
    run, methods = (
        RunFolder(request.root),
        {label: find_method(label, request.networks) for label in request.labels},
    )
    for label, spec in methods.items():
        if reason := PREPARATIONS.why_absent(spec.preparation):
            raise AbsentPartError(f"{label}: {reason}")
    protocol = request.protocol.over(request.capture.n_frames)
    if (
        not protocol.views.folds
        and run.protocol_file.is_file()
        and (run_protocol := run.protocol()).agrees_with(protocol)
    ):
        protocol = run_protocol
    request = replace(request, protocol=protocol)
    calibrated, calibration, choice = request.capture, None, protocol.synthesis.calibration
    if choice == "refined" or (choice and CALIBRATIONS.is_present("calibration")):
        calibrated, calibration = CALIBRATIONS["calibration"](request, protocol)
    capture = fit_capture(calibrated, protocol)
    require_owner(run, protocol, capture)
    visible, device = visible_cameras(capture, protocol), request.networks.device
    depth = depth_of_run(run, request.depth, visible, protocol, device, methods)
    views = depth.sources([capture.camera(view) for view in protocol.views.test])
    plans = {
        view: replace(plan, shares=dict.fromkeys(plan.shares, 1.0)) for view, plan in views.items()
    }
    planned = RunPlan(
        request=request,
        run=run,
        methods=methods,
        depth=depth,
        original=capture,
        plans=plans,
        calibration=calibration,
    )
    for preparation in PREPARATIONS.built_in().values():
        planned = preparation.complete(planned)
    return replace(planned, original=replace(capture, notes=(*capture.notes, *depth.notes)))


def visible_cameras(capture: Capture, protocol: Protocol) -> Capture:
    """Return the capture without the cameras that no method may see (`Views.sources_of`)."""
    sources = protocol.views.sources_of(capture.scene)
    return (
        capture.without([name for name in capture.camera_names if name not in sources], "not seen")
        if sources
        else capture
    )


def fit_capture(capture: Capture, protocol: Protocol) -> Capture:
    """Return the capture at the protocol's size."""
    for doing, names, key in (
        ("tests", protocol.views.test, "test"),
        ("shows", protocol.views.sources_of(capture.scene), "sources"),
    ):
        absent = [name for name in names if name not in capture.camera_names]
        if absent:
            raise CaptureError(
                f"{capture.path}: protocol {protocol.name} {doing} {', '.join(absent)}, got "
                f"{', '.join(capture.camera_names)}; choose another protocol or edit views.{key}"
            )
    frames = protocol.frames.numbers
    if frames.stop > capture.n_frames:
        raise CaptureError(
            f"{capture.path}: protocol {protocol.name} wanted frames "
            f"{frames.start}..{frames.stop - 1}, got {capture.n_frames}; lower frames.count"
        )
    synthesis = protocol.synthesis
    if synthesis.width:
        return capture.resized(synthesis.width, synthesis.height, synthesis.resize_filter)
    return capture
