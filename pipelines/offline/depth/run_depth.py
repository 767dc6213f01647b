"""Depth of a run, matched between cameras or measured by sensors: how it is found, and of which
cameras.
"""

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import listed
from ggvs_eval.depth_options import DEVICE, UNEXPLAINED, DepthRunOptions, default_matcher
from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.errors import (
    CameraError,
    DepthError,
    DeviceError,
    GgvsError,
    GgvsWarning,
    ProtocolError,
)
from ggvs_eval.geometry.sight import require_sight
from ggvs_eval.geometry.source_views import ChosenSource
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.methods.network_options import checked_device
from ggvs_eval.pipelines.methods.render_unit import SourcePlan
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.pipelines.methods.stage_costs import depth_cost
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.fill_store import (
    DepthPartners,
    plan_rig_depth,
    prepare_depth,
)
from ggvs_eval.pipelines.offline.depth.rig_depth import RigDepth
from ggvs_eval.pipelines.offline.depth.sensor_and_stereo import SENSORS, unexplained
from ggvs_eval.progress import counted
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder, read_json, write_json
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.task import read_record

# What a refusal for want of depth adds.
WITHOUT_DEPTH = "methods without depth, such as enerf and ibrnet, still run"


@dataclass(frozen=True)
class MatchedDepth:
    """Depth that is matched between cameras or measured by sensors, a `DepthProvider`.

    Attributes:
        choice: how it is found.
        device: where a network computes that finds it; ``cpu`` where none does.
        compared: by what depth of sensors was chosen; empty where nothing was compared.
        methods: that are rendered.
        partners: of the cameras that methods may see.
    """

    run: RunFolder
    protocol: Protocol
    choice: DepthRunOptions
    device: str
    compared: Mapping[str, Any]
    methods: Collection[MethodSpec]
    partners: DepthPartners

    @classmethod
    def of_run(
        cls,
        run: RunFolder,
        request: DepthRunOptions | None,
        capture: Capture,
        protocol: Protocol,
        device: str,
        methods: Collection[MethodSpec],
    ) -> "MatchedDepth":
        """Choose how depth is found: as the folder says, as the user asks, or the default.

        Args:
            run: a folder whose depth, if it has any, is found the same way.
            capture: holds the cameras that methods may see.
            device: of networks, where the folder names none.
            methods: that are rendered; none if the run is only prepared.
        """
        choice, device, compared = _recorded_choice(run, request, device)
        is_wanted = any(spec.uses_depth for spec in methods)
        if choice.sensor == "compare" and capture.sensed_cameras and is_wanted:
            choice, compared = _use_sensors(choice, capture, protocol, device)
        options = choice.options(device)
        n_sensed = len(capture.sensed_cameras) if options.sensor else 0
        if n_sensed and not options.sensor_fills and choice.matcher != default_matcher():
            cameras = f"{counted(n_sensed, 'camera')} whose depth is measured or given"
            words = f"--matcher {choice.matcher} has no effect on {cameras}"
            advice = "use it with --sensor fill or --sensor no"
            warnings.warn(f"{capture.path}: {words}; {advice}", GgvsWarning, stacklevel=2)
        partners = DepthPartners(capture, options)
        return cls(run, protocol, choice, device, compared, methods, partners)

    @staticmethod
    def is_outdated(run: RunFolder) -> bool:
        """Return whether all depth of a run was found by other code."""
        specs = [read_record(folder).get("identity", {}) for folder in run.depth.glob("*/")]
        codes = {spec["options"].get("code") for spec in specs if "options" in spec}
        try:
            options = DepthRunOptions.from_record(read_json(run.depth_record)).options()
            of_sensors = [code_of(str(SENSORS.root(name))) for name in SENSORS.present()]
            return bool(codes) and codes.isdisjoint([options.describe()["code"], *of_sensors])
        except (GgvsError, TypeError):
            return False

    @property
    def options(self) -> DepthOptions:
        """All parameters."""
        return self.partners.options

    @property
    def cost(self) -> float | None:
        """Core-seconds per megapixel of a map; None if they are not known."""
        return depth_cost(self.choice.matcher)

    @property
    def notes(self) -> list[str]:
        """What a reader of the results should know, once all sources are chosen."""
        notes = []
        if UNEXPLAINED in self.compared:
            how = "where stereo finds none" if self.choice.sensor == "fill" else "alone"
            words = "of other cameras' pictures unexplained"
            sensor, stereo = self.compared[UNEXPLAINED]
            levels = f"it leaves {sensor:.1f} levels {words}, stereo's {stereo:.1f}"
            notes.append(f"sensors' depth is used {how}: {levels}")
        if self.partners.unmatched:
            notes.append(self.partners.describe_unmatched())
        return notes

    def sources(self, targets: Sequence[Camera]) -> dict[str, SourcePlan]:
        """Choose the sources of each target, and what their depth is matched with.

        Raises:
            CameraError: fewer sources than the protocol wants, or sources that can show too little
                of a test view.
            DepthError: a target none of whose sources has depth, where a method wants it.
        """
        partners, capture = self.partners, self.partners.capture
        k, how = self.protocol.synthesis.k, self.protocol.synthesis.sources
        sources_of = {target.name: partners.sources(target, k, how) for target in targets}
        is_wanted = any(spec.uses_depth for spec in self.methods)
        if is_wanted or not self.methods:
            self._require_sight(targets, sources_of)
        blind = []
        for target in targets:
            if not any(
                partners.has_depth(source.camera, target) for source in sources_of[target.name]
            ):
                blind.append(target.name)
        if blind and is_wanted:
            without = f"no source of {listed(blind)} has depth; {partners.describe_unmatched()}"
            raise DepthError(f"{capture.path}: {without}; {WITHOUT_DEPTH}")
        plans = {}
        for target in targets:
            sources = sources_of[target.name]
            shares = {source.camera.name: source.share for source in sources}
            plans[target.name] = SourcePlan(target, partners.jobs(target, sources), shares)
        return plans

    def of_rig(self, capture: Capture) -> tuple[DepthJob, ...]:
        """Return the depth of the cameras of a capture, matched with each other."""
        return plan_rig_depth(capture, self.options)

    def write_record(self) -> None:
        """Let the folder keep how depth is found, which a run without depth may have left
        undecided.
        """
        if self.compared or not self.run.depth_record.is_file():
            write_json(self.run.depth_record, self.choice.record(self.device) | dict(self.compared))

    def first_needed(self, frame: int) -> int:
        """Return the instant that depth of an instant goes back to."""
        return self.options.first_needed(frame)

    def fill(
        self,
        capture: Capture,
        jobs: Sequence[DepthJob],
        frames: Sequence[int],
        store: DepthStore,
        workers: Workers,
    ) -> None:
        """Compute the depth that is missing, where the run's other depth was computed."""
        try:
            prepare_depth(capture, jobs, frames, store, self.options, workers)
        except DeviceError as error:
            record = f"{self.run.depth_record}: this run's depth is found on {self.device}"
            raise DeviceError(f"{record}: {error}; or use a new run folder") from error

    def live_rig(
        self, cameras: Sequence[Camera], partners: Mapping[str, Sequence[str]]
    ) -> RigDepth:
        """Return what finds this depth as pictures arrive."""
        return RigDepth(cameras, self.options, partners)

    def _require_sight(
        self, targets: Sequence[Camera], sources_of: Mapping[str, Sequence[ChosenSource]]
    ) -> None:
        """Refuse test views of which their sources can show too little."""
        capture = self.partners.capture
        sensed = capture.sensed_cameras if self.options.sensor else frozenset[str]()
        unseen: dict[str, CameraError] = {}
        for target in targets:
            if target.name not in self.protocol.views.test:
                continue
            sources = [source.camera for source in sources_of[target.name]]
            try:
                require_sight(target, sources, capture.cameras, sensed)
            except CameraError as error:
                unseen[target.name] = error
        if unseen:
            (_, first), *further = unseen.items()
            names = listed(name for name, _ in further)
            more = f"; the same holds for {names}" if further else ""
            raise CameraError(f"{first}{more}; {WITHOUT_DEPTH}") from first


def _use_sensors(
    choice: DepthRunOptions, capture: Capture, protocol: Protocol, device: str
) -> tuple[DepthRunOptions, dict[str, Any]]:
    """Choose how depth of sensors is used, by what explains the pictures of other cameras.

    Test views are not asked.

    Depth that the user gave is used as it is, and so is a sensor's where nothing can be compared.
    """
    names = tuple(name for name in capture.camera_names if name not in protocol.views.test)
    compared = None
    if not capture.given_depth:
        compared = unexplained(capture, names, choice.options(device), protocol.frames.start)
    fills = compared is not None and compared[1] < compared[0]
    record = {UNEXPLAINED: list(compared)} if compared else {}
    return replace(choice, sensor="fill" if fills else "alone"), record


def _recorded_choice(
    run: RunFolder, request: DepthRunOptions | None, device: str
) -> tuple[DepthRunOptions, str, dict[str, Any]]:
    """Return how this folder's depth is found, or will be, on which device, and by what it was
    chosen.

    Methods of one table must be given the same.

    Reading:
        Learned depth stays on the device that found its first map, regardless of the device of
        later calls: else a run that was prepared on a GPU would be prepared again where it is
        looked at. That device is missed only where a map is.
    """
    if not run.depth_record.is_file():
        choice = request or DepthRunOptions()
        return choice, checked_device(device) if choice.is_learned else "cpu", {}
    values = read_json(run.depth_record)
    record = DepthRunOptions.from_record(values)
    if request not in (None, record, replace(record, sensor="compare")):
        found_by = f"{record.options().matcher.name} ({run.depth_record.name})"
        raise ProtocolError(
            f"{run.root}: holds a run whose depth is found by {found_by}, wanted {request}; choose "
            f"a new folder"
        )
    compared = {name: values[name] for name in values if name == UNEXPLAINED}
    return record, values.get(DEVICE, "cpu"), compared
