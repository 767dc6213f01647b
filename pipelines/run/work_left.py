"""Work left in runs and results of other code, counted from their plans and folders; nothing is written."""

import shutil
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ggvs_eval.depth_store import DepthStore
from ggvs_eval.depth_work import depth_left
from ggvs_eval.errors import GgvsError, ProtocolError, ResultsError
from ggvs_eval.jobs.machine import pace
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.methods.render_unit import PATH
from ggvs_eval.pipelines.methods.stage_costs import (
    CHECKED_DEPTH,
    DECODED,
    STAGES,
    render_cost,
    score_cost,
    stage_of,
)
from ggvs_eval.pipelines.run.depth_of_run import DEPTH, MATCHED
from ggvs_eval.pipelines.run.derived_files import frames_left
from ggvs_eval.pipelines.run.render import method_code
from ggvs_eval.pipelines.run.run_plan import PREPARATIONS, TRUTH_BYTES, Piece, RunPlan
from ggvs_eval.pipelines.run.score_code import metric_code
from ggvs_eval.progress import counted, duration
from ggvs_eval.protocol import COSTLIEST
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json

DEPTH_BYTES, RENDER_BYTES = 2.9, 1.5  # per pixel: depth as it is stored, PNG of renders
PAGE_SHARE = 0.3  # of the renders; a page keeps small copies of them
GB = 1e9
WORTH_A_TABLE_S = 120.0  # of a core; below, two lines are enough


@dataclass(frozen=True)
class Stage:
    """Work left in one stage.

    Attributes:
        name: of `STAGES`.
        count: frames, maps or scenes.
        unknown: how many of them have no estimate.
        seconds: of the others, by all processes.
        n_bytes: that it writes.
    """

    name: str
    count: int
    unknown: int
    seconds: float
    n_bytes: float

    def describe(self) -> str:
        """Return one line."""
        known = self.count - self.unknown
        each = f"{self.seconds / known:.2g} s each" if known else "not known"
        whole = f", {duration(self.seconds)}" if known else ""
        disk = f", {_size(self.n_bytes)}" if self.n_bytes else ""
        return f"  {self.name}: {self.count}, {each}{whole}{disk}"


@dataclass(frozen=True)
class Workload:
    """Remaining work of a run, or of several.

    Attributes:
        pieces: of all runs, each once.
        frame_seconds: method -> seconds of a frame, as its jobs that are done took; methods without one are missing.
        jobs: processes.
        pace: seconds that work takes here for each second of `Piece.core_seconds`.
    """

    title: str
    pieces: tuple[Piece, ...]
    folder: Path
    frame_seconds: Mapping[str, float] = field(default_factory=dict)
    jobs: int = 1
    pace: Callable[[], float] = pace

    def count(self, *kinds: str) -> int:
        """Return the number of pieces left of some kinds."""
        return sum(piece.count for piece in self.pieces if piece.kind in kinds)

    @property
    def disk_bytes(self) -> float:
        """Bytes that the runs will still take at once: what is passing makes room for renders."""
        passing = sum(piece.n_bytes for piece in self.pieces if piece.passing)
        later = sum(piece.n_bytes for piece in self.pieces if piece.label and not piece.passing)
        rest = sum(piece.n_bytes for piece in self.pieces if not piece.label and not piece.passing)
        return rest + max(passing, later)

    @property
    def free_bytes(self) -> int:
        """Free on the disk they go to."""
        folder = self.folder.resolve()
        while not folder.is_dir():
            folder = folder.parent
        return shutil.disk_usage(folder).free

    def is_nothing(self) -> bool:
        """Return whether everything is done."""
        return not self.pieces

    def describe(self) -> str:
        """Return a few lines; none if everything is done."""
        if self.is_nothing():
            return ""
        parts = [
            f"{self.count('render', 'path render')} frames to render",
            f"{self.count('depth', 'checked depth')} depth maps",
        ]
        views = sum(piece.kind == "score" for piece in self.pieces)
        others = [
            (self.count("truth"), "captured frame", "decode"),
            (self.count("fit"), "scene", "fit"),
            (views, "view", "score"),
        ]
        parts += [f"{counted(count, noun)} to {doing}" for count, noun, doing in others if count]
        lines = [
            f"plan: {self.title}; left are {', '.join(parts)}",
            f"disk: about {_size(self.disk_bytes)} more in {self.folder}, {_size(self.free_bytes)} free",
        ]
        return "\n".join([*lines, *self._time_lines()])

    def _time_lines(self) -> list[str]:
        """A line per stage where it takes a while; on this machine, by a probe and by the frames that are rendered already."""
        known = sum(piece.core_seconds or 0.0 for piece in self.pieces)
        rendering = sum(piece.count * self.frame_seconds.get(piece.label, 0.0) for piece in self.pieces if piece.label)
        if max(known, rendering) < WORTH_A_TABLE_S:
            return []
        stages = [stage for stage in (self._stage(name) for name in STAGES) if stage.count]
        whole_s = sum(stage.seconds for stage in stages)
        longest = max(stages, key=lambda stage: stage.seconds)
        unknown = sum(stage.unknown for stage in stages)
        more = f", and {counted(unknown, 'piece')} of unknown time" if unknown else ""
        return [
            f"time: about {duration(whole_s)} on {counted(self.jobs, 'core')}{more}; mostly {longest.name}; to shorten: "
            f"{STAGES[longest.name]}",
            *(stage.describe() for stage in stages),
        ]

    def _stage(self, name: str) -> "Stage":
        """Return the sum of what is left of a stage; frames of a method take as long as those that it has rendered."""
        pieces = [piece for piece in self.pieces if stage_of(piece.kind) == name]
        seconds, unknown = 0.0, 0
        for piece in pieces:
            if piece.label in self.frame_seconds:
                seconds += piece.count * self.frame_seconds[piece.label]
            elif piece.core_seconds is not None:
                seconds += piece.core_seconds * self.pace()
            else:
                unknown += piece.count
        count, n_bytes = sum(piece.count for piece in pieces), sum(piece.n_bytes for piece in pieces)
        return Stage(name, count, unknown, seconds / self.jobs, n_bytes)

    def require_disk(self) -> None:
        """Refuse runs that the disk has no room for."""
        needed, free = self.disk_bytes, self.free_bytes
        if needed > free:
            raise ProtocolError(
                f"{self.folder}: this run needs about {_size(needed)}, the disk has {_size(free)} free; free the difference, "
                "choose a folder on another disk, or reduce the run (frames.count, views.test, synthesis.width, methods)"
            )


def count_work(plans: Sequence[RunPlan], folder: Path, jobs: int = 1) -> Workload:
    """Count the work left in runs."""
    seconds: dict[str, list[float]] = defaultdict(list)
    for plan in plans:
        for label in plan.request.labels:
            seconds[label] += _frame_seconds(plan, label)
    means = {label: sum(values) / len(values) for label, values in seconds.items() if values}
    pieces = {(piece.kind, piece.folder): piece for plan in plans for piece in work_left(plan)}
    return Workload(_title(plans), tuple(pieces.values()), folder, means, jobs)


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
    notes = [note for plan in plans for note in plan.capture.notes if note not in plan.request.capture.notes]
    lines = [*dict.fromkeys(notes), *work.describe().splitlines()]
    if lines or dry_run:
        print("\n".join(lines) or f"{folder}: no work left", file=sys.stdout if dry_run else sys.stderr)
    work.require_disk()


def describe_outdated(runs: Iterable[RunFolder]) -> str:
    """Count what other code than this version's has made in run folders: renders, their depth, scored views; empty if nothing.

    Reading:
        Methods and metrics that this version does not have are not counted: nothing here would make them again.
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
        for records in (_identity(run.scores(view)).values() for view in views):
            metrics = {name: known for each in records for name, known in each.get("metrics", {}).items() if name in METRICS}
            scored += any(known["code"] != metric_code(METRICS[name]) for name, known in metrics.items())
        depth += MATCHED in DEPTH and DEPTH[MATCHED].is_outdated(run)
    parts = [f"{counted(len(renders), 'render')} ({', '.join(dict.fromkeys(renders))})"] if renders else []
    parts += ["the depth of renders"] if depth else []
    parts += [counted(scored, "scored view")] if scored else []
    return f"{', '.join(parts)} are of another version of the code" if parts else ""


def _is_outdated(label: str, identity: Mapping[str, Any]) -> bool:
    """Return whether a render was made by other code than the method's of this version."""
    try:
        method = find_method(label, NetworkOptions(device="cuda" if "device" in identity else "cpu"))
    except GgvsError:
        return False
    return "code" in identity and identity["code"] != method_code(method)


def _identity(folder: Path) -> dict[str, Any]:
    """Return the recorded inputs of a result; empty if there is none."""
    try:
        return dict(read_json(folder / JOB_FILE)["identity"])
    except (ResultsError, KeyError, TypeError):
        return {}


def work_left(plan: RunPlan) -> list[Piece]:
    """List the missing parts of one run."""
    return [piece for piece in _pieces(plan) if piece.count]


def _pieces(plan: RunPlan) -> Iterator[Piece]:
    run, root = plan.run, plan.shared_root / "truth"
    for name, frames in frames_left(plan.original, plan.frames_of_cameras(), root).items():
        yield plan.piece("truth", root / name, len(frames), DECODED, TRUTH_BYTES)
    depth_costs = {"depth": plan.depth.cost, "checked depth": CHECKED_DEPTH}
    store = DepthStore(plan.shared_root / "depth")
    kept = {store.folder(job.key) for jobs, _ in plan.depth_work() for job in jobs}
    for kind, counts in _depth_left(plan, store).items():
        for folder, count in counts.items():
            passing = plan.request.shared is None and folder not in kept
            yield plan.piece(kind, folder, count, depth_costs[kind], DEPTH_BYTES, passing=passing)
    for preparation in PREPARATIONS.built_in().values():
        yield from preparation.work_left(plan)
    left = [job for job in plan.jobs.render if not job.is_done()]
    for job in left:
        is_path = job.units == (PATH,)
        kind, count = ("path render", len(plan.path)) if is_path else ("render", len(plan.frames))
        pixel_bytes = RENDER_BYTES * (1 + PAGE_SHARE)
        cost = render_cost(job.label)
        yield plan.piece(kind, job.folder, count, cost, pixel_bytes, job.label)
    stale, views = {unit for job in left for unit in job.units}, plan.request.views
    for view in plan.plans if plan.methods else ():
        is_asked = views is None or view in views
        if is_asked and (view in stale or not _is_scored(run, view, [*plan.methods])):
            cost = score_cost(plan.protocol.measurement) * len(plan.methods)
            yield plan.piece("score", run.scores(view), len(plan.frames), cost)


def _depth_left(plan: RunPlan, store: DepthStore) -> dict[str, dict[Path, int]]:
    """Return the missing depth maps by folder of the store: as found, and checked against others."""
    kinds = "depth", "checked depth"
    counts: dict[str, dict[Path, int]] = {kind: {} for kind in kinds}
    for jobs, frames in plan.depth_work():
        for kind, left in zip(kinds, depth_left(jobs, frames, store), strict=True):
            for job, missing in left.items():
                folder = store.folder(job.key)
                counts[kind][folder] = max(counts[kind].get(folder, 0), len(missing))
    return counts


def _is_scored(run: RunFolder, view: str, labels: Sequence[str]) -> bool:
    """Return whether a view has values of these methods; whether they are still of the same frames, scoring itself finds out."""
    try:
        return set(labels) <= set(read_json(run.scores(view) / JOB_FILE)["methods"])
    except (ResultsError, KeyError, TypeError):
        return False


def _frame_seconds(plan: RunPlan, label: str) -> list[float]:
    """Return the mean seconds of a frame in each test view that a method has rendered."""
    seconds = []
    for view in plan.plans:
        try:
            stages = read_json(plan.run.renders(label, view) / JOB_FILE)["seconds"].values()
            seconds += [sum(map(sum, stages)) / len(plan.frames)] if stages else []  # none of a view that it cannot show
        except (ResultsError, KeyError, TypeError, AttributeError):
            continue
    return seconds


def _title(plans: Sequence[RunPlan]) -> str:
    first = plans[0]
    width, height = first.original.cameras[0].size
    labels = first.request.labels
    methods = f" x {len(labels)} methods" if labels else ""
    many = f"{len(plans)} runs of " if len(plans) > 1 else ""
    ks = ", ".join(map(str, sorted({plan.protocol.synthesis.k for plan in plans})))
    measured = (plan.protocol.measurement for plan in plans)
    every = {each.lpips_every for each in measured if each.lpips_every > 1 and any(COSTLIEST in name for name in each.metrics)}
    lpips = f", {COSTLIEST} of one frame in {' or '.join(map(str, sorted(every)))}" if every else ""
    return f"{many}{len(first.plans)} views x {len(first.frames)} frames{methods} at {width} x {height}, K = {ks}{lpips}"


def _size(n_bytes: float) -> str:
    return f"{n_bytes / GB:.1f} GB" if n_bytes >= GB / 10 else f"{n_bytes / 1e6:.1f} MB"
