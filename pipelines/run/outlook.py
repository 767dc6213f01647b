"""Work left in runs and results of other code, counted from their plans and folders.

Nothing is written.
"""

import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.coverage import read_coverage
from ggvs_eval.errors import GgvsError, ProtocolError
from ggvs_eval.jobs.machine import Estimate, estimate, pace
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.methods.stage_costs import STAGES, score_cost, stage_of
from ggvs_eval.pipelines.run.depth_of_run import DEPTH, MATCHED
from ggvs_eval.pipelines.run.render import UnitTask, method_code
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.pipelines.run.score_code import metric_code
from ggvs_eval.pipelines.run.score_view import score_tasks
from ggvs_eval.progress import counted, duration
from ggvs_eval.protocol import COSTLIEST
from ggvs_eval.run_folder import JOB_FILE, RunFolder
from ggvs_eval.tasks.task import FileTask, Made, Result, left_of, read_record

RENDERS = ("render", "path render")
GB = 1e9
WORTH_A_TABLE_S = 120.0  # of a core; below, two lines are enough


@dataclass(frozen=True)
class Workload:
    """Remaining work of a run, or of several.

    Attributes:
        left: what is left to make, each once.
        history: what is made, by whose time that of the rest is estimated.
        passing: folders whose files go before anything is rendered.
        jobs: processes.
        pace: seconds that work takes here for each core-second of `Result.cost_s`.
    """

    title: str
    left: tuple[Result, ...]
    history: tuple[Made, ...]
    folder: Path
    passing: frozenset[Path] = frozenset()
    jobs: int = 1
    pace: Callable[[], float] = pace

    def count(self, *kinds: str) -> int:
        """Return the number of files left of some kinds."""
        return sum(task.count for task in self.left if task.kind in kinds)

    @property
    def disk_bytes(self) -> float:
        """Bytes that the runs will still take at once: what is passing makes room for renders."""
        passing = sum(_bytes(task) for task in self.left if task.folder in self.passing)
        later = sum(_bytes(task) for task in self.left if task.kind in RENDERS)
        remaining = sum(
            _bytes(task)
            for task in self.left
            if task.kind not in RENDERS and task.folder not in self.passing
        )
        return remaining + max(passing, later)

    @property
    def free_bytes(self) -> int:
        """Free on the disk they go to."""
        folder = self.folder.resolve()
        return shutil.disk_usage(next(filter(Path.is_dir, (folder, *folder.parents)))).free

    def describe(self) -> str:
        """Return a few lines; none if everything is done."""
        if not self.left:
            return ""
        parts = [
            f"{self.count(*RENDERS)} frames to render",
            f"{self.count('depth', 'checked depth')} depth maps",
        ]
        views = len({task.batch for task in self.left if task.kind == "score"})
        stages = [
            (self.count("truth"), "captured frame", "decode"),
            (self.count("fit"), "scene", "fit"),
            (views, "view", "score"),
        ]
        parts += [f"{counted(count, noun)} to {doing}" for count, noun, doing in stages if count]
        lines = [
            f"plan: {self.title}; left are {', '.join(parts)}",
            f"disk: about {_size(self.disk_bytes)} more in {self.folder}, {_size(self.free_bytes)} "
            f"free",
        ]
        return "\n".join([*lines, *self._time_lines()])

    def _time_lines(self) -> list[str]:
        """A line per stage where it takes a while.

        On this machine, by a probe and by what was made here already.
        """
        at_pace_1 = estimate(self.left, self.history, lambda: 1.0)
        if at_pace_1.seconds < WORTH_A_TABLE_S:
            return []
        stages = {
            name: [task for task in self.left if stage_of(task.kind) == name] for name in STAGES
        }
        times = {
            name: estimate(tasks, self.history, self.pace)
            for name, tasks in stages.items()
            if tasks
        }
        longest = max(times, key=lambda name: times[name].seconds)
        unknown = sum(time.unknown for time in times.values())
        more = f", and {counted(unknown, 'piece')} of unknown time" if unknown else ""
        whole_s = sum(time.seconds for time in times.values()) / self.jobs
        return [
            f"time: about {duration(whole_s)} on {counted(self.jobs, 'core')}{more}; mostly "
            f"{longest}; to shorten: {STAGES[longest]}",
            *(self._stage_line(name, stages[name], time) for name, time in times.items()),
        ]

    def _stage_line(self, name: str, tasks: Sequence[Result], time: Estimate) -> str:
        count, n_bytes = sum(task.count for task in tasks), sum(map(_bytes, tasks))
        n_timed, seconds = count - time.unknown, time.seconds / self.jobs
        of_one = f"{seconds / n_timed:.2g} s each" if n_timed else "not known"
        total = f", {duration(seconds)}" if n_timed else ""
        disk = f", {_size(n_bytes)}" if n_bytes else ""
        return f"  {name}: {count}, {of_one}{total}{disk}"

    def require_disk(self) -> None:
        """Refuse runs that the disk has no room for."""
        needed, free = self.disk_bytes, self.free_bytes
        if needed > free:
            raise ProtocolError(
                f"{self.folder}: this run needs about {_size(needed)}, the disk has {_size(free)} "
                "free; free the difference, choose a folder on another disk, or reduce the run "
                "(frames.count, views.test, synthesis.width, methods)"
            )


def count_work(plans: Sequence[RunPlan], folder: Path, jobs: int = 1) -> Workload:
    """Count the work left in runs."""
    left: dict[Path, Result] = {}
    records: list[Made] = []
    passing: set[Path] = set()
    for plan in plans:
        tasks = plan.tasks
        missing = left_of(tasks)
        renders = [task for task in plan.renders if task.is_done()]
        records += [render.made for render in renders]
        left |= {task.folder: task for task in (*missing, *_scores_left(plan, missing))}
        if plan.request.shared is None:
            passing |= {
                task.folder for task in missing if isinstance(task, FileTask) and task.passes
            }
            passing -= {task.folder for task in tasks}
    return Workload(
        title=_title(plans),
        left=tuple(left.values()),
        history=tuple(records),
        folder=folder,
        passing=frozenset(passing),
        jobs=jobs,
    )


def print_plan(plans: Sequence[RunPlan], jobs: int, folder: Path, dry_run: bool = False) -> None:
    """Print what runs will do, as a few lines; nothing if all is done.

    Args:
        plans: of the runs.
        jobs: processes.
        folder: where they go.
        dry_run: print it on stdout, and a line even where all is done: nothing will follow.

    Raises:
        ProtocolError: they need more room than the disk has.
    """
    if not plans:
        return
    if outdated := describe_outdated([plan.run for plan in plans]):
        print(f"{folder}: {outdated}; they are recomputed", file=sys.stderr)
    work = count_work(plans, folder, jobs)
    notes = [
        note
        for plan in plans
        for note in plan.capture.notes
        if note not in plan.request.capture.notes
    ]
    lines = [*dict.fromkeys(notes), *work.describe().splitlines()]
    if lines or dry_run:
        print(
            "\n".join(lines) or f"{folder}: no work left",
            file=sys.stdout if dry_run else sys.stderr,
        )
    work.require_disk()


def describe_outdated(runs: Iterable[RunFolder]) -> str:
    """Count what other code than this version's has made in run folders: renders, their depth,
    scored views; empty if nothing.

    Reading:
        Methods and metrics that this version does not have are not counted: nothing here would make
        them again.
    """
    renders: list[str] = []
    scored = depth = 0
    for run in runs:
        if not run.protocol_file.is_file():
            continue
        views = run.protocol().views.test
        for label in run.labels():
            folders = (*(run.renders(label, view) for view in views), run.path(label))
            renders += [label for folder in folders if _is_outdated(label, _identity(folder))]
        scored += sum(_has_outdated_scores(run.scores(view)) for view in views)
        depth += MATCHED in DEPTH and DEPTH[MATCHED].is_outdated(run)
    parts = (
        [f"{counted(len(renders), 'render')} ({', '.join(dict.fromkeys(renders))})"]
        if renders
        else []
    )
    parts += ["the depth of renders"] if depth else []
    parts += [counted(scored, "scored view")] if scored else []
    return f"{', '.join(parts)} are of another version of the code" if parts else ""


def _has_outdated_scores(folder: Path) -> bool:
    """Return whether values of a view were measured by other code than their metric's, or kept as
    an earlier version did.
    """
    folders = (
        file.parent for file in folder.glob(f"*/*/{JOB_FILE}") if file.parent.name in METRICS
    )
    is_other = (
        _identity(metric).get("code") != metric_code(METRICS[metric.name]) for metric in folders
    )
    return (folder / JOB_FILE).is_file() or any(is_other)


def _is_outdated(label: str, identity: Mapping[str, Any]) -> bool:
    """Return whether a render was made by other code than the method's of this version."""
    try:
        method = find_method(
            label, NetworkOptions(device="cuda" if "device" in identity else "cpu")
        )
    except GgvsError:
        return False
    return "code" in identity and identity["code"] != method_code(method)


def _identity(folder: Path) -> dict[str, Any]:
    return dict(read_record(folder).get("identity", {}))


def _scores_left(plan: RunPlan, missing: Sequence[Result]) -> Iterator[Result]:
    """Yield the scores of the views that are asked for.

    Of views that are not rendered yet, they are not known one by one.
    """
    if not plan.methods:
        return
    unrendered = {unit for task in missing if isinstance(task, UnitTask) for unit in task.units}
    views = [
        view for view in plan.plans if plan.request.views is None or view in plan.request.views
    ]
    width, height = plan.original.cameras[0].size
    cost_s = score_cost(plan.protocol.measurement) * width * height / 1e6 * len(plan.methods)
    for view in views:
        if view in unrendered:
            folder = plan.run.scores(view)
            yield Result(
                f"scores of {view}", folder, kind="score", count=len(plan.frames), cost_s=cost_s
            )
    rendered, labels = [view for view in views if view not in unrendered], [*plan.methods]
    if rendered:
        coverage, device = (
            read_coverage(plan.run, plan.frames, labels),
            plan.request.networks.device,
        )
        for view in rendered:
            yield from left_of(score_tasks(plan.run, plan.protocol, coverage, labels, view, device))


def _title(plans: Sequence[RunPlan]) -> str:
    first = plans[0]
    width, height = first.original.cameras[0].size
    labels = first.request.labels
    methods = f" x {len(labels)} methods" if labels else ""
    many = f"{len(plans)} runs of " if len(plans) > 1 else ""
    ks = ", ".join(map(str, sorted({plan.protocol.synthesis.k for plan in plans})))
    measurements = (plan.protocol.measurement for plan in plans)
    every = {
        measurement.lpips_every
        for measurement in measurements
        if measurement.lpips_every > 1 and any(COSTLIEST in name for name in measurement.metrics)
    }
    lpips = f", {COSTLIEST} of one frame in {' or '.join(map(str, sorted(every)))}" if every else ""
    return (
        f"{many}{len(first.plans)} views x {len(first.frames)} frames{methods} at {width} x "
        f"{height}, K = {ks}{lpips}"
    )


def _bytes(task: Result) -> float:
    return task.count * task.n_bytes


def _size(n_bytes: float) -> str:
    return f"{n_bytes / GB:.1f} GB" if n_bytes >= GB / 10 else f"{n_bytes / 1e6:.1f} MB"
