"""The verbs of the command line that make runs: prepare, render, score, merge, run, sweep, status."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from ggvs_eval import built_in
from ggvs_eval.capture import Capture
from ggvs_eval.errors import ProtocolError, ResultsError, WeightsError
from ggvs_eval.jobs.ledger import Failure
from ggvs_eval.pipelines.commands.flags import (
    CAPTURE_DEFAULTS,
    DEPTH_DEFAULTS,
    HERE,
    NONE,
    ONE_PER_CORE,
    USUAL_METHODS,
    CaptureFlags,
    CaptureOptions,
    DepthFlags,
    Device,
    Jobs,
    Labels,
    Output,
    Run,
    Running,
    Weights,
    changed_flags,
)
from ggvs_eval.pipelines.methods.network_options import NetworkOptions, checked_device
from ggvs_eval.pipelines.methods.registry import METHODS, find_method, weights_takers
from ggvs_eval.pipelines.methods.splats import named_splats, splats_notes
from ggvs_eval.plugins import Registry
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder

NO_SPLATS: Mapping[str, Path] = {}
PLANS: Registry[Any] = Registry("plans of sweeps", built_in.SWEEP_PLANS)


def prepare(
    run: Run,
    capture: Path,
    protocol: str | None = None,
    fuse: bool = False,
    dense_workspace: Path | None = None,
    device: Device = "cpu",
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = DEPTH_DEFAULTS,
    engine: Running = HERE,
    dry_run: bool = False,
) -> None:
    """Read a capture under a protocol and write what every method needs: truth frames, source views, depth, a page.

    Args:
        run: run folder to make or to go on with.
        capture: folder of the capture; its layout is detected.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        fuse: also fuse the first instant into a point cloud and a mesh, RUN/fused/<frame>/{points,mesh}.ply.
        dense_workspace: also write the first instant's depth as a COLMAP dense workspace into this folder.
        device: where the network of depth computes (--matcher raft); the run's depth stays on it.
        reading: how the capture is read.
        depth: how depth is found.
        engine: where jobs run.
        dry_run: print the remaining work, its disk use and estimated time, then exit.
    """
    from ggvs_eval.pipelines.run.depth_outputs import export_prepared, fuse_prepared, write_prepared_page
    from ggvs_eval.pipelines.run.prepare import prepare_run
    from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
    from ggvs_eval.pipelines.run.work_left import print_plan

    networks = _networks((), device)
    root, opened = engine.place(run), _open(reading, engine.place(capture), protocol)
    chosen = _protocol(protocol, opened)
    plan = plan_run(RunRequest(root, opened, chosen, depth=depth, networks=networks))
    print_plan([plan], engine.jobs, root, dry_run)
    if dry_run:
        return
    prepared = prepare_run(plan, engine)
    print(write_prepared_page(prepared, engine.jobs))
    if fuse:
        fused = fuse_prepared(prepared)
        print(fused.points, fused.mesh, sep="\n")
    if dense_workspace:
        print(export_prepared(prepared, dense_workspace))


def render(
    run: Run, methods: Labels = USUAL_METHODS, weights: Weights = (), device: Device = "cpu", engine: Running = HERE
) -> None:
    """Synthesise every test view of a prepared run by each method.

    Args:
        run: run folder that `prepare` has made.
        methods: which methods, splats:PATH for 3D Gaussians that others have fitted; what is rendered already is left alone.
        weights: METHOD=FILE of a method whose weights do not ship: the authors' checkpoint of a baseline.
        device: where networks of methods compute; GPU results can differ from the CPU's by 1/255 per pixel.
        engine: where jobs run.
    """
    from ggvs_eval.pipelines.run.evaluate import render as synthesise
    from ggvs_eval.pipelines.run.evaluate import reopen

    methods, splats = named_splats(methods)
    networks = _networks(weights, device, splats)
    _require_methods(methods, networks)
    prepared = reopen(engine.place(run), engine, methods, networks)
    print(f"{synthesise(prepared, engine)} jobs rendered in {run}")


def score(
    folder: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None,
    renders: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=PATH ...", help_behavior_hint=NONE)] = (),
    capture: Path | None = None,
    protocol: str | None = None,
    run: Path | None = None,
    allow_partial: bool = False,
    link: bool = False,
    device: Device = "cpu",
    first_frame: int | None = None,
    with_truth: bool = False,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Measure all renders of a run, and frames that others rendered, under one protocol.

    Args:
        folder: run folder to score; --run says the same.
        renders: NAME=PATH of your own frames, which become a method of the run: a folder <view>/<frame>.png or
            <view>_<frame>.jpg, a video or numpy stack per view, renders/ beside gt/ as 3DGS writes them or rgb/ beside gt-rgb/ as
            nerfstudio does, a run folder, NerfBaselines output, or an archive.
        capture: what was rendered; makes a run folder of its captured frames where there is none.
        protocol: a .toml file or a packaged name; the run's own, or the packaged one that fits the capture, by default.
        run: run folder to make or to go on with; scores/CAPTURE by default.
        allow_partial: score what there is of incomplete renders; their row is marked.
        link: take PNG files as links in place of copies: no space, but they must stay where they are.
        device: where LPIPS, SSIM, TCC, STED and other metrics of many operations compute; a GPU rounds otherwise than the CPU.
        first_frame: number of the protocol's first frame in the names of your frames (its place, from 0, in videos and arrays);
            needed where the numbers can be read in two ways.
        with_truth: score published renders without a capture, against the truth in them: .npz with arrays `renders` and `gts`
            (T, H, W, 3), one per view. Rows are marked "own truth"; of --protocol the measures alone are taken.
        reading: how the capture is read.
        jobs: processes.
    """
    from ggvs_eval.pipelines.run.import_renders import import_renders, named_renders, run_for
    from ggvs_eval.pipelines.run.own_truth import compare_published, run_with_truth
    from ggvs_eval.pipelines.run.score import require_labels
    from ggvs_eval.pipelines.run.score import score as measure

    if folder and run:
        raise ProtocolError(f"wanted one run folder, got {folder} and --run {run}; give one of them")
    named = named_renders(renders)
    if with_truth and capture:
        raise ProtocolError(f"wanted --capture or --with-truth, got both; without --with-truth {capture} is the truth")
    opened = partial(reading.open, capture) if capture else None
    root = run or folder
    with run_with_truth(root, named, protocol) if with_truth else run_for(root, opened, protocol, jobs) as target:
        for name, path in named.items():
            for note in import_renders(target, name, path, allow_partial, jobs, first_frame, link)["notes"]:
                print(f"{name}: {note}", file=sys.stderr)
        require_labels(target)
    results = measure(target, jobs, device=checked_device(device))
    print(results.summary().droplevel("dataset").round(4).to_string())
    if with_truth:
        print("own truth: measured against the pictures that came with the renders, not against a capture")
        print(*compare_published(named, results), sep="\n", end="\n" if named else "")
    for label, mark in results.partial.items():
        print(f"{label} is {mark}")
    for line in results.fault_lines():
        print(line)
    for metric, reason in results.not_computed.items():
        print(f"{metric} not computed: {reason}")
    lacking = dict.fromkeys((one.metric, one.view or "all views of some methods", one.reason) for one in results.absences)
    for metric, where, reason in lacking:
        print(f"{metric} not computed in {where}: {reason}")


def merge(
    out: Output,
    runs: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN RUN [RUN ...]", help_behavior_hint="(at least two)")
    ],
    copy: bool = False,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Put run folders of one capture and protocol, made on several machines, into a new one, and make its table.

    The runs may differ in their methods and in the views that were rendered; what two of them both have must be the same.

    Args:
        out: output run folder; written atomically.
        runs: run folders; they stay as they are.
        copy: copy files; otherwise they are linked where the file system can.
        jobs: processes that measure what no run has measured.
    """
    from ggvs_eval.pipelines.run.score import score
    from ggvs_eval.pipelines.sweep.merging.merge import merge_runs

    if len(runs) < 2:
        raise ResultsError(f"wanted at least two run folders to merge into {out}, got {len(runs)}; copy a single one")

    def finish(merged: RunFolder) -> None:
        missing = _missing_renders(merged)
        if missing:
            print(f"{out}: no table yet, {missing}; merge the runs that have them, or render them here", file=sys.stderr)
        else:
            print(score(merged, jobs).summary().droplevel("dataset").round(4).to_string())

    print(merge_runs(out, runs, copy, finish).root)


def run(
    run: Run,
    capture: Path | None = None,
    protocol: str | None = None,
    methods: Labels = USUAL_METHODS,
    weights: Weights = (),
    device: Device = "cpu",
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = DEPTH_DEFAULTS,
    engine: Running = HERE,
    dry_run: bool = False,
) -> None:
    """Run the whole evaluation (prepare, render, score, report); resumes completed steps.

    Args:
        run: run folder to make or to go on with.
        capture: folder of the capture; without one the demo rooms that ship are evaluated, each beside the run folder: the
            main one, also over K, and small ones in the layouts of ENeRF-Outdoor and D3DMV. One page shows them all. With
            --protocol the main one alone.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        methods: which methods; by default the demo's smallest room has the baselines too. splats:PATH or NAME=splats:PATH renders
            3D Gaussians that others have fitted: a .ply, a folder with one per frame, an output folder of 3D Gaussian splatting.
        weights: METHOD=FILE of a method whose weights do not ship: the authors' checkpoint of a baseline.
        device: where networks compute, of methods and of depth (--matcher raft); on a GPU pixels may differ by a level from those
            of the CPU.
        reading: how the capture is read.
        depth: how depth is found.
        engine: where jobs run.
        dry_run: print the remaining work, its disk use and estimated time, then exit.
    """
    from ggvs_eval.pipelines.run.evaluate import measure, report
    from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
    from ggvs_eval.pipelines.run.work_left import print_plan
    from ggvs_eval.pipelines.sweep.demo_runs import demo_plans, room_labels, run_demos, unpack_rooms

    methods, splats = named_splats(methods)
    root, networks = engine.place(run), _networks(weights, device, splats)
    _require_methods(methods, networks)
    unpack = unpack_rooms(reading.open, dry_run)
    if capture is None and protocol is None:
        labels = room_labels(methods)
        run_demos(root, labels, demo_plans(root, labels, unpack, depth, networks), engine, dry_run)
        return
    opened = _open(reading, engine.place(capture), protocol) if capture else unpack.beside(root)
    chosen = _protocol(protocol, opened)
    plan = plan_run(RunRequest(root, opened, chosen, methods, depth, networks))
    print_plan([plan], engine.jobs, root, dry_run)
    if dry_run:
        return
    for line in measure(plan, engine).fault_lines():
        print(line, file=sys.stderr)
    print(report([root]))


def sweep(
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP")],
    out: Output,
    capture: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="CAPTURE ...", help_behavior_hint=NONE)] = (),
    protocol: str | None = None,
    weights: Weights = (),
    device: Device = "cpu",
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = DEPTH_DEFAULTS,
    engine: Running = HERE,
    shard: str = "1/1",
    plan: Path | None = None,
    dry_run: bool = False,
) -> None:
    """Evaluate every row of a sweep under each of its variants and print one table of all.

    What fails is listed at the end and does not stop the rest; the same call tries it again, and only it.

    Args:
        name: a packaged sweep (ablations, ablations_short, baselines, budget, k, offline, online, readings, stream,
            switches) or a .toml file.
        out: folder of the sweep; each variant is a run folder in it, of several captures in a folder called like the capture.
        capture: folder of the capture, or of several, whose means are then shown too; without one the demo that ships.
        protocol: what the variants start from; by default the packaged one that fits the capture.
        weights: METHOD=FILE of a method whose weights do not ship; without, its rows are not computed.
        device: where networks compute, of methods and of depth (--matcher raft); on a GPU pixels may differ by a level from those
            of the CPU.
        reading: how the capture is read.
        depth: how depth is found.
        engine: where jobs run.
        shard: i/n, for the i-th of n machines: every n-th view; 0/n prepares for all. A last call without it makes the table.
        plan: JSON file to write instead of running: the commands of the sweep, and which waits for which.
        dry_run: print the remaining work, its disk use and estimated time, then exit.
    """
    from ggvs_eval.jobs.shard import Shard
    from ggvs_eval.pipelines.run.work_left import print_plan
    from ggvs_eval.pipelines.sweep.demo_runs import unpack_rooms
    from ggvs_eval.pipelines.sweep.run_sweep import plan_cells, run_sweep
    from ggvs_eval.sweep import load_sweep

    definition, part = load_sweep(name), Shard.parse(shard)
    networks = _networks(weights, "cpu" if plan else device)  # planned commands may run where there is a GPU
    given = [_open(reading, engine.place(path), protocol) for path in capture]
    captures = given or [unpack_rooms(reading.open, dry_run and plan is None).beside(engine.place(out))]
    paths = [each.path for each in captures]
    opened = {each.path.resolve().name: each for each in captures}
    if len(opened) < len(capture):
        raise ProtocolError(f"wanted captures whose folders differ in name, got {', '.join(map(str, capture))}; rename one")
    starts = {folder if len(opened) > 1 else "": (each, _protocol(protocol, each)) for folder, each in opened.items()}
    if plan:
        options = [*changed_flags(reading, CAPTURE_DEFAULTS), *changed_flags(depth, DEPTH_DEFAULTS), *changed_flags(engine, HERE)]
        chosen = [*(["--protocol", protocol] if protocol else []), *(["--weights", *weights] if weights else [])]
        chosen += ["--device", device] if device != "cpu" else []
        command = ["ggvs-eval", "sweep", name, str(out), "--capture", *map(str, paths), *chosen, *options]
        print(PLANS["commands"](plan, engine.place(out), starts, definition, networks, command))
        return
    planned = plan_cells(engine.place(out), starts, definition, depth, networks, part)
    print_plan(planned.plans, engine.jobs, engine.place(out), dry_run)
    if dry_run:
        _end_with(planned.failures, "the rest can be made")
        return
    result = run_sweep(planned, engine)
    if not result.table.empty:
        print(result.table.round(4).to_string())
    for title, reason in result.not_computed.items():
        print(f"{title} not computed: {reason}")
    _end_with(result.failures)


def status(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_SWEEP")]) -> None:
    """Show progress, failures and disk use of a run or sweep, also while it runs.

    Args:
        folder: run folder, or folder of a sweep.
    """
    from ggvs_eval.jobs.ledger import describe_status
    from ggvs_eval.pipelines.run.work_left import describe_outdated

    print(describe_status(folder))
    if outdated := describe_outdated([RunFolder(folder)]):
        print(f"{folder}: {outdated}; `ggvs-eval run` makes them again")


def _end_with(failures: tuple[Failure, ...], rest: str = "the rest is done, the same call tries only these again") -> None:
    """List what failed, our own bugs with their tracebacks, and end with 1."""
    for failure in failures:
        print(failure.traceback or "", f"failed: {failure}", sep="", file=sys.stderr)
    if failures:
        sys.exit(f"ggvs-eval: {len(failures)} failed, listed above; {rest}")


def _networks(weights: tuple[str, ...], device: str, splats: Mapping[str, Path] = NO_SPLATS) -> NetworkOptions:
    """METHOD=FILE, as often as wanted, files of Gaussians by their labels, and a device that is there."""
    return NetworkOptions(_checkpoints(weights), splats, checked_device(device))


def _require_methods(methods: Sequence[str], networks: NetworkOptions) -> None:
    """Refuse a mistyped method before anything is read."""
    for label in methods:
        find_method(label, networks)
    for path in networks.splats.values():
        for note in splats_notes(path):
            print(note, file=sys.stderr)


def _checkpoints(weights: tuple[str, ...]) -> dict[str, Path]:
    checkpoints: dict[str, Path] = {}
    for each in weights:
        method, equals, file = each.partition("=")
        if not equals or method not in METHODS or not Path(file).is_file():
            able = ", ".join(label for label in weights_takers() if "+" not in label)
            raise WeightsError(f"--weights {each}: wanted METHOD=FILE with one of {able} and a file that exists")
        checkpoints[method] = Path(file).resolve()
    return checkpoints


def _open(reading: CaptureOptions, path: Path, protocol: str | None) -> Capture:
    """Open a capture as its protocol wants it: with the cameras that are out of step where the protocol keeps them."""
    from ggvs_eval.pipelines.run.import_renders import asked_protocol

    keeps = protocol is not None and asked_protocol(protocol).views.keep_unsynced
    return (replace(reading, keep_unsynced=True) if keeps else reading).open(path)


def _protocol(source: str | None, capture: Capture) -> Protocol:
    from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
    from ggvs_eval.protocol import load_protocol

    return load_protocol(source) if source else suggest_protocol(capture)


def _missing_renders(run: RunFolder) -> str:
    """Views that methods of a merged run lack, as text; empty where nothing is missing."""
    from ggvs_eval.coverage import read_import

    views = run.protocol().views.test
    own = [label for label in run.labels() if read_import(run, label) is None]
    lacking = {label: [view for view in views if not run.renders(label, view).is_dir()] for label in own}
    return "; ".join(f"{label} lacks {', '.join(some)}" for label, some in lacking.items() if some)
