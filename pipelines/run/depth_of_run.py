"""Where the depth of a run's source cameras comes from: matched, or from nowhere for methods that
want none.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from typing import Protocol as Door

import numpy as np

from ggvs_eval import built_in
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import listed
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthJob, DepthMap, DepthStore, describe_depth
from ggvs_eval.depth_work import missing_depth
from ggvs_eval.errors import AbsentPartError
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.methods.render_unit import SourcePlan
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.plugins import Registry
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder

MATCHED = "depth"
# classes that make a `DepthProvider` of a run
DEPTH: Registry[Any] = Registry("depth", built_in.DEPTH)


class DepthProvider(Door):
    """Where the depth of the cameras of a run comes from.

    Attributes:
        cost: core-seconds per megapixel of a map, at `pace` 1; None if it is not known.
        notes: on the capture, once all sources are chosen.
    """

    @property
    def cost(self) -> float | None: ...  # noqa: D102

    @property
    def notes(self) -> Sequence[str]: ...  # noqa: D102

    def sources(self, targets: Sequence[Camera], /) -> dict[str, SourcePlan]:
        """Choose the source cameras of each target, and how their depth is found."""

    def of_rig(self, capture: Capture, /) -> tuple[DepthJob, ...]:
        """Return the depth of the cameras of a capture, as they are without any target."""

    def write_record(self) -> None:
        """Let the run folder keep how depth is found."""

    def first_needed(self, frame: int, /) -> int:
        """Return the instant from which on frames are needed for the depth of one."""

    def fill(
        self,
        capture: Capture,
        jobs: Sequence[DepthJob],
        frames: Sequence[int],
        store: DepthStore,
        workers: Workers,
        /,
    ) -> None:
        """Write the maps that a store lacks."""

    def live_rig(self, cameras: Sequence[Camera], partners: Mapping[str, Sequence[str]], /) -> Any:
        """Return the `RigDepth` that finds this depth as pictures arrive; None if nothing does."""


@dataclass(frozen=True)
class NearestCameras:
    """Sources of which no depth is known, a `DepthProvider`.

    Attributes:
        capture: holds the cameras that methods may see.
    """

    capture: Capture
    protocol: Protocol
    cost: float = 0.0
    notes: tuple[str, ...] = ()

    def sources(self, targets: Sequence[Camera]) -> dict[str, SourcePlan]:
        """Choose the sources of each target."""
        synthesis, cameras = self.protocol.synthesis, self.capture.cameras
        plans = {}
        for target in targets:
            sources = choose_sources(target, cameras, synthesis.k, synthesis.sources)
            shares = {source.camera.name: source.share for source in sources}
            jobs = tuple(self._unknown_depth(source.camera) for source in sources)
            plans[target.name] = SourcePlan(target, jobs, shares)
        return plans

    def of_rig(self, capture: Capture) -> tuple[DepthJob, ...]:
        """Return one job per camera."""
        return tuple(map(self._unknown_depth, capture.cameras))

    def write_record(self) -> None:
        """Leave it undecided how depth is found."""

    def first_needed(self, frame: int) -> int:
        """Return the instant itself."""
        return frame

    def fill(
        self,
        capture: Capture,
        jobs: Sequence[DepthJob],
        frames: Sequence[int],
        store: DepthStore,
        _workers: Workers,
    ) -> None:
        """Write maps that are unknown everywhere."""
        instants_by_job, _ = missing_depth(jobs, frames, store)
        for job, instants in instants_by_job.items():
            camera, key = capture.camera(job.camera_name), store.write_spec(job.spec)
            unknown = np.zeros((camera.height, camera.width), np.float32)
            for frame in instants:
                store.write(key, frame, DepthMap(unknown, unknown))

    def live_rig(self, _cameras: object, _partners: object) -> None:
        """Return nothing: no depth is found."""

    def _unknown_depth(self, camera: Camera) -> DepthJob:
        digests = {camera.name: self.capture.digest(camera.name)}
        return DepthJob(
            camera.name, (), spec=describe_depth(camera, (), digests, {"algorithm": "none"})
        )


def depth_of_run(
    run: RunFolder,
    options: DepthRunOptions | None,
    capture: Capture,
    protocol: Protocol,
    device: str,
    methods: Mapping[str, MethodSpec],
) -> DepthProvider:
    """Return where the depth of the cameras comes from that methods may see.

    Raises:
        AbsentPartError: the user or a method wants depth, which is not installed.
    """
    reason = DEPTH.why_absent(MATCHED)
    if not reason:
        provider: DepthProvider = DEPTH[MATCHED].of_run(
            run, options, capture, protocol, device, methods.values()
        )
        return provider
    wanting = [label for label, spec in methods.items() if spec.uses_depth]
    if wanting or options:
        raise AbsentPartError(f"{listed(wanting or ['--matcher'])}: {reason}")
    return NearestCameras(capture, protocol)
