"""The demo rooms evaluated one after another, the figure over K, and one page of all: `ggvs-eval
run` without a capture.
"""

import atexit
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from ggvs_eval.built_in import LEARNED_BASELINES
from ggvs_eval.capture import Capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import Failure, RenderError
from ggvs_eval.jobs.engine import Engine, Workers, as_engine
from ggvs_eval.jobs.machine import estimate, pace
from ggvs_eval.jobs.processes import kept_workers
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.methods.registry import usual_methods
from ggvs_eval.pipelines.run.evaluate import measure, report
from ggvs_eval.pipelines.run.outlook import count_work, print_plan
from ggvs_eval.pipelines.run.prepare import drop_found_depth
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.pipelines.sweep.run_sweep import SweepPlan, plan_cells, run_sweep
from ggvs_eval.progress import duration
from ggvs_eval.protocol import load_protocol
from ggvs_eval.results import split_label
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.sweep import Sweep, load_sweep
from ggvs_eval.synthetic.shipped import MAIN, ROOMS, write_room
from ggvs_eval.tasks.task import Result

K_PROTOCOL = "demo-k"
FEW = ("no-blending", "distance-based", "ours")
FIRST_FRAMES = 8  # of the main room, on the first page
# at most, after that of the whole main room: each page costs what a small room does
PAGE_EVERY_S = 90.0
# Seconds until that page, and of evaluating each room by the usual methods, and over K, times the
# cores: at `pace` 1.
FIRST_CORE_SECONDS = 160.0
CORE_SECONDS = {MAIN: 600.0, "demo-enerf-outdoor": 90.0, "demo-d3dmv": 320.0, K_PROTOCOL: 210.0}
# What is evaluated where no methods are named: in the main room also an opponent that readers know,
# in the smallest one all that the paper compares itself with.
SMALL_ROOMS_METHODS = {
    "demo-enerf-outdoor": FEW,
    "demo-d3dmv": (*FEW[:2], "fwd", "gps-gaussian+given-depth", "ibrnet", "enerf", FEW[2]),
}


@dataclass(frozen=True)
class Unpacking:
    """Unpacker and opener of a demo room.

    Attributes:
        open: opens the capture of a folder.
        elsewhere: folder that rooms are unpacked into in place of their own; None for their own.
    """

    open: Callable[[Path], Capture]
    elsewhere: Path | None = None

    def __call__(self, folder: Path, name: str) -> Capture:
        """Return the capture of a room's name; an existing folder is used unchanged."""
        place = self.elsewhere / folder.name if self.elsewhere and not folder.exists() else folder
        return self.open(write_room(place, name))

    def beside(self, root: Path) -> Capture:
        """Return the main room, next to a run folder."""
        return self(capture_beside(root), MAIN)


def unpack_rooms(open_room: Callable[[Path], Capture], dry_run: bool) -> Unpacking:
    """Give the unpacker of demo rooms; a dry run unpacks elsewhere, until the process ends."""
    if not dry_run:
        return Unpacking(open_room)
    elsewhere = TemporaryDirectory()
    atexit.register(elsewhere.cleanup)
    return Unpacking(open_room, Path(elsewhere.name))


def demo_plans(
    root: Path,
    labels: Mapping[str, Sequence[str]],
    unpack: Callable[[Path, str], Capture],
    depth: DepthRunOptions | None = None,
    networks: NetworkOptions = AS_SHIPPED,
    rooms: Sequence[str] = ROOMS,
    in_stages: bool = True,
) -> Iterator[RunPlan | SweepPlan]:
    """Plan the run of every demo room as soon as it is unpacked, and the main one's sweep over K.

    Learned baselines take longer than all the rest: they come last, by a second plan of the same
    run.

    Args:
        root: run folder of the main room; the others' are next to it, and each capture next to its
            run.
        labels: name of a room -> its methods, see `room_labels`.
        unpack: gives the capture of a folder and a room's name.
        rooms: by the names of their protocols.
        in_stages: plan learned baselines apart; otherwise each run has one plan, which counts all
            that is left of it.
    """
    sweep, last = k_sweep(labels[MAIN]), []
    for name in rooms:
        place = demo_root(root, name)
        capture, shared = (
            unpack(capture_beside(place), name),
            root if name == MAIN and sweep.row else None,
        )
        request = RunRequest(
            root=place,
            capture=capture,
            protocol=load_protocol(name),
            labels=labels[name],
            depth=depth,
            networks=networks,
            shared=shared,
        )
        early = [label for label in labels[name] if split_label(label)[0] not in LEARNED_BASELINES]
        if in_stages and 0 < len(early) < len(labels[name]):
            last.append(request)
            request = replace(request, labels=early)
        yield plan_run(request)
    if sweep.row:
        main = unpack(capture_beside(root), MAIN)
        yield plan_cells(
            k_root(root),
            {"": (main, load_protocol(K_PROTOCOL))},
            sweep,
            depth,
            networks,
            shared=root,
        )
    yield from map(plan_run, last)


@kept_workers()
def evaluate_demos(
    planned: Iterable[RunPlan | SweepPlan],
    workers: Workers,
    show: Callable[[Path], None] = lambda _: None,
) -> Path:
    """Evaluate every demo room, the main one also over K; a second call does only what is missing.

    The page is there as soon as the first frames of the first room are evaluated, and grows with
    every further run.

    Args:
        planned: see `demo_plans`; each is made when the one before is done.
        show: is called with the page when it has grown, at most every `PAGE_EVERY_S`, except for
            the last time.

    Returns:
        The page of all rooms, in the main room's run folder.
    """
    roots: list[Path] = []
    tables: list[Path] = []
    plans: list[RunPlan] = []
    failures: tuple[Failure, ...] = ()
    has_grown, shown_s = False, -PAGE_EVERY_S
    for plan in planned:
        if (
            has_grown and time.monotonic() - shown_s > PAGE_EVERY_S
        ):  # asked here, as the last page is written once, with its figures
            show(report(roots, tables_of=tables, with_figures=False))
            has_grown, shown_s = False, time.monotonic()
        plans += plan.plans if isinstance(plan, SweepPlan) else [plan]
        if isinstance(plan, SweepPlan):
            result = run_sweep(plan, workers)
            failures, tables = result.failures, [] if result.table.empty else [plan.root]
            continue
        left = count_work([plan], plan.run.root)
        if (
            not roots
            and left.count("depth", "checked depth")
            and plan.protocol.frames.count > FIRST_FRAMES
        ):
            show(show_first_frames(plan, workers))
        measure(plan, workers)
        shutil.rmtree(first_root(plan.run.root), ignore_errors=True)
        roots = [*dict.fromkeys([*roots, plan.run.root])]
        has_grown |= bool(left.left)
    if not failures:
        drop_found_depth(plans)
    page = report(roots, tables_of=tables, jobs=as_engine(workers).jobs)
    if failures:
        raise RenderError(
            f"{k_root(roots[0])}: {len(failures)} failed, first {failures[0]}; run the same "
            f"command to retry"
        )
    return page


def show_first_frames(plan: RunPlan, workers: Workers) -> Path:
    """Evaluate the first frames of a run's views, and write the page of these in its place, which
    says so.

    Captured frames and depth are the run's own. Renders and scores are a run of their own in its
    folder, which goes when all frames are evaluated.
    """
    protocol, count = plan.protocol, plan.protocol.frames.count
    title = (
        f"{protocol.dataset}: first {FIRST_FRAMES} of {count} frames, the others are being "
        f"evaluated"
    )
    frames = replace(protocol.frames, count=FIRST_FRAMES)
    first = replace(
        protocol, dataset=title, frames=frames, path=replace(protocol.path, poses=0, cameras=())
    )
    root = first_root(plan.run.root)
    measure(
        plan_run(replace(plan.request, root=root, protocol=first, shared=plan.shared_root)), workers
    )
    return report([root], plan.run.report, with_figures=False)


def first_root(root: Path) -> Path:
    """Return the folder of the run of a run's first frames, which goes when all are evaluated."""
    return root / "first_frames"


def run_demos(
    root: Path,
    labels: Mapping[str, Sequence[str]],
    planned: Iterable[RunPlan | SweepPlan],
    engine: Engine,
    dry_run: bool = False,
) -> None:
    """Evaluate the demo rooms and print what is left of each, how long all take, and where the page
    is.

    Args:
        root: run folder of the main room.
        labels: name of a room -> its methods.
        planned: see `demo_plans`.
        dry_run: print what is left alone.
    """

    def announce(plan: RunPlan | SweepPlan) -> RunPlan | SweepPlan:
        if isinstance(plan, RunPlan):
            print_plan([plan], engine.jobs, plan.run.root, dry_run)
            return plan
        print_plan(plan.plans, engine.jobs, plan.root, dry_run)
        for failure in plan.failures if dry_run else ():
            print(f"failed: {failure}", file=sys.stderr)
        return plan

    def show(page: Path) -> None:
        print(
            f"{page} can be opened; it grows with the frames and runs that follow",
            file=sys.stderr,
            flush=True,
        )

    announced = map(announce, planned)
    if dry_run:
        deque(announced, maxlen=0)
        return
    if outlook := describe_outlook(root, labels, engine.jobs):
        print(outlook, file=sys.stderr, flush=True)
    print(evaluate_demos(announced, engine, show))


def describe_outlook(
    root: Path, labels: Mapping[str, Sequence[str]], jobs: int, probe: Callable[[], float] = pace
) -> str:
    """State in one line the time of the demo and of its first page.

    Empty once its rooms are evaluated.

    Args:
        labels: name of a room -> its methods.
        probe: seconds that work takes here for each second of `CORE_SECONDS`.
    """
    page = RunFolder(root).report / "index.html"
    if (page.is_file() and not first_root(root).exists()) or any(
        name not in CORE_SECONDS for name in labels
    ):
        return ""
    rooms = [Result(name, root, cost_s=seconds) for name, seconds in CORE_SECONDS.items()]
    first_page = Result("first page", root, cost_s=FIRST_CORE_SECONDS)
    total, first = (
        estimate(results, pace=probe).seconds / jobs for results in (rooms, [first_page])
    )
    return (
        f"demo: about {duration(total)} in all on {jobs} cores; in about {duration(first)} open "
        f"{page}, which grows"
    )


def room_labels(labels: Sequence[str]) -> dict[str, Sequence[str]]:
    """Return the name of a demo room -> its methods: rooms have their own lists if these are the
    default ones.
    """
    usual = tuple(labels) == usual_methods()
    return (
        {MAIN: (*labels, "fwd"), **SMALL_ROOMS_METHODS}
        if usual
        else {name: labels for name in ROOMS}
    )


def demo_root(root: Path, name: str) -> Path:
    """Run folder of a demo room: the given one, or ``<root>-<layout>`` next to it."""
    return root.with_name(root.name + name.removeprefix(MAIN))


def k_root(root: Path) -> Path:
    """Return the folder of the main room's sweep over K."""
    return root.with_name(f"{root.name}-k")


def k_sweep(labels: Sequence[str]) -> Sweep:
    """Return the packaged sweep over K with those of its methods that are wanted."""
    sweep = load_sweep("k")
    return replace(sweep, row=tuple(row for row in sweep.row if row.method in labels))


def capture_beside(root: Path) -> Path:
    """Return the folder of the capture of a demo's run."""
    return root.with_name(f"{root.name}-capture")
