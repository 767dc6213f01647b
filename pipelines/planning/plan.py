"""A run is planned before it starts: how much there is to do, whether disk and memory suffice, and how long it will take."""

import shutil
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from ggvs_eval.errors import ProtocolError
from ggvs_eval.jobs.free_memory import available_bytes
from ggvs_eval.jobs.processes import worker_pool
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.planning.demo_plan import films
from ggvs_eval.pipelines.planning.estimate import Pace, Portion, disk_bytes
from ggvs_eval.pipelines.planning.probe import probe
from ggvs_eval.pipelines.planning.rates import Rates
from ggvs_eval.pipelines.planning.run_request import RunRequest
from ggvs_eval.pipelines.planning.work_left import WorkLeft, plan_frames, work_left
from ggvs_eval.pipelines.run.prepare import Prepared, depth_choice_of, open_run
from ggvs_eval.run_folder import RunFolder

PROBED_FROM_PIXELS = 5e7  # depth maps and frames to render; the demo has 2e8, its small rooms 2e7 each
GB = 1e9


@dataclass(frozen=True)
class RunPlan:
    """What stands before a run, or before several that share their frames.

    Attributes:
        title: frames, views, methods, size.
        portions: what is left of each run.
        rates: what was tried; None where the runs are too small for that.
        probed_k: source cameras in that trial.
        jobs: processes.
        folder: where the runs go.
        films: what has to be rendered first, a line for each capture.
    """

    title: str
    portions: tuple[Portion, ...]
    rates: Rates | None
    probed_k: int
    jobs: int
    folder: Path
    films: Sequence[str] = ()

    @property
    def disk_bytes(self) -> float:
        """What the runs will still write."""
        return disk_bytes(self.portions, self.rates)

    @property
    def free_bytes(self) -> int:
        """Free on the disk they go to."""
        return shutil.disk_usage(_existing(self.folder)).free

    def stage_seconds(self) -> dict[str, float]:
        """Estimate of every stage's wall time, without the page; empty where nothing was tried."""
        return {} if self.rates is None else Pace(self.rates, self.probed_k, self.jobs).stage_seconds(self.portions)

    def is_nothing(self) -> bool:
        """Whether everything is done."""
        return all(each.left.is_nothing() for each in self.portions)

    def describe(self) -> str:
        """A few lines; none where everything is done."""
        if self.is_nothing():
            return ""
        depth_maps: dict[Path, int] = {}
        for each in self.portions:
            depth_maps |= {**each.left.found_depth, **each.left.checked_depth}
        maps = f"{sum(depth_maps.values())} depth maps"
        rendered = sum(each.left.n_rendered for each in self.portions)
        lines = [*self.films, f"plan: {self.title}; left are {rendered} frames to render, {maps}"]
        lines.append(f"disk: about {_size(self.disk_bytes)} more in {self.folder}, {_size(self.free_bytes)} free")
        if self.rates is not None:
            lines += [self._memory_line(self.rates), self._time_line(self.rates)]
        return "\n".join(lines)

    def _memory_line(self, rates: Rates) -> str:
        free = available_bytes()
        fitting = max(int(min(free / max(rates.memory_bytes, 1.0), 1e6)), 0)
        few = f"; only {max(fitting, 1)} of {self.jobs} will run at once" if fitting < self.jobs else ""
        return f"memory: about {_size(rates.memory_bytes)} per process, {_size(free)} available{few}"

    def _time_line(self, rates: Rates) -> str:
        stages = self.stage_seconds()
        parts = ", ".join(f"{stage} {duration(seconds)}" for stage, seconds in stages.items() if seconds)
        total = duration(sum(stages.values()))
        processes = "1 process" if self.jobs == 1 else f"{self.jobs} processes"
        return f"time: about {total} in {processes} ({parts}; without the page), by a trial of {duration(rates.took_s)}"

    def require_disk(self) -> None:
        """Refuse what cannot fit.

        Raises:
            ProtocolError: the disk has less room than the runs need.
        """
        needed, free = self.disk_bytes, self.free_bytes
        if needed > free:
            raise ProtocolError(
                f"{self.folder}: this run needs about {_size(needed)}, the disk has {_size(free)} free; free the difference, "
                "choose a folder on another disk, or ask for less (frames.count, views.test, synthesis.width, methods)"
            )


def plan_runs(requests: Sequence[RunRequest], jobs: int, folder: Path, keep: bool = True) -> RunPlan:
    """Count what runs still have to do, and try a little of it where that is worth the time.

    Args:
        requests: the runs, which lie below one folder.
        jobs: processes.
        folder: where all of them go.
        keep: what the trial makes goes where the runs find it; else into a folder that is thrown away.

    Raises:
        CaptureError: a capture lacks what its protocol asks for.
        ProtocolError: a folder belongs to another run, or its depth is found otherwise.
    """
    trials = [(depth_choice_of(RunFolder(request.root), request.depth).options(), request) for request in requests]
    planned, portions = zip(*(_count(request, options) for options, request in trials), strict=True)
    unfilmed = films({request.capture.path: request.capture for request in requests}.values())
    plan = RunPlan(_title(requests, portions), portions, None, 1, jobs, folder, unfilmed)
    if unfilmed or sum(each.n_pixels * (each.left.n_depth + each.left.n_rendered) for each in portions) < PROBED_FROM_PIXELS:
        return plan
    plan.require_disk()
    index = max(range(len(portions)), key=lambda i: portions[i].left.n_rendered)
    rates = _tried(requests[index], portions[index].left, planned[index], trials[index][0], jobs, keep)
    if keep:  # what the trial has made is done
        portions = tuple(_count(request, options)[1] for options, request in trials)
    return replace(plan, rates=rates, probed_k=portions[index].k, portions=portions)


def _count(request: RunRequest, options: DepthOptions) -> tuple[Prepared, Portion]:
    """The plan of a run and what is left of it."""
    planned, truth = plan_frames(request.root, request.capture, request.protocol, options, request.shared)
    left = work_left(planned, truth, options, request.labels, request.networks, request.shared, request.views)
    width, height = planned.capture.cameras[0].size
    return planned, Portion(left, width * height, request.protocol.synthesis.k)


def _tried(request: RunRequest, left: WorkLeft, planned: Prepared, options: DepthOptions, jobs: int, keep: bool) -> Rates:
    """The trial of what is left, in a process that has as many threads as those of the run."""
    with ExitStack() as stack:
        if keep:
            root = request.root
            open_run(planned.run, planned.protocol, planned.capture, request.depth)
        else:
            root = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=".plan.", dir=_existing(request.root))))
        shared = (request.shared or root) if keep else root
        labels = [label for label in request.labels if label in left.rendered] or request.labels
        specs = {label: find_method(label, request.networks) for label in labels}
        pool = stack.enter_context(worker_pool(jobs))
        return pool.submit(probe, replace(planned, run=RunFolder(root)), options, specs, shared, time.time()).result()


def _title(requests: Sequence[RunRequest], portions: Sequence[Portion]) -> str:
    """What the runs are."""
    first = requests[0]
    width, height = first.protocol.synthesis.width, first.protocol.synthesis.height
    if not width:
        width, height = first.capture.cameras[0].size
    views, frames = len(first.protocol.views.test), first.protocol.frames.count
    methods = f" x {len(first.labels)} methods" if first.labels else ""
    many = f"{len(requests)} runs of " if len(requests) > 1 else ""
    ks = ", ".join(map(str, sorted({portion.k for portion in portions})))
    return f"{many}{views} views x {frames} frames{methods} at {width} x {height}, K = {ks}"


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that there is."""
    folder = folder.resolve()
    while not folder.is_dir():
        folder = folder.parent
    return folder


def _size(n_bytes: float) -> str:
    return f"{n_bytes / GB:.1f} GB" if n_bytes >= GB / 10 else f"{n_bytes / 1e6:.1f} MB"


def duration(seconds: float) -> str:
    """A length of time in the unit that suits it."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
