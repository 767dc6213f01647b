"""The verbs of the command line that make runs: prepare, render, score, merge, run, sweep,
status.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from ggvs_eval import built_in
from ggvs_eval.capture import Capture
from ggvs_eval.errors import Failure, ProtocolError, ResultsError, WeightsError
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
    Poses,
    Run,
    Running,
    Weights,
    changed_flags,
)
from ggvs_eval.pipelines.methods.network_options import NetworkOptions, checked_device
from ggvs_eval.pipelines.methods.registry import METHODS, find_method, named_scenes, weights_takers
from ggvs_eval.plugins import Registry
from ggvs_eval.protocol import CalibrationChoice, Protocol
from ggvs_eval.run_folder import RunFolder

NO_SPLATS: Mapping[str, Path] = {}
DEPTH_OUTPUTS: Registry[Any] = Registry("outputs of depth", built_in.DEPTH_OUTPUTS)
PLANS: Registry[Any] = Registry("plans of sweeps", built_in.SWEEP_PLANS)
LINES: Registry[Any] = Registry("lines below the table of a sweep", built_in.SWEEP_LINES)


def prepare(
    run: Run,
    capture: Path,
    protocol: str | None = None,
    fuse: bool = False,
    dense_workspace: Path | None = None,
    poses: Poses = None,
    device: Device = "cpu",
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = DEPTH_DEFAULTS,
    engine: Running = HERE,
    dry_run: bool = False,
) -> None:
    """Write reference frames, source views and depth of a capture.

    Args:
        run: run folder to create or resume.
        capture: folder of the capture; its layout is detected.
        protocol: protocol (.toml or packaged name); fitted to the capture by default.
        fuse: also fuse the first instant into RUN/fused/<frame>/{points,mesh}.ply.
        dense_workspace: folder for the first instant's depth as a COLMAP dense workspace.
        poses: cameras given, refined, or compare: refined if source cameras render better; the
            protocol's by default.
        device: device of depth networks (--matcher raft); stored with the run.
        reading: capture reading.
        depth: depth estimation.
        engine: job execution.
        dry_run: print the remaining work, its disk use and estimated time, then exit.
    """
    from ggvs_eval.pipelines.run.outlook import print_plan
    from ggvs_eval.pipelines.run.prepare import prepare_run
    from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run

    networks = _networks((), device)
    root, opened = engine.place(run), _open(reading, engine.place(capture), protocol)
    terms = _protocol(protocol, opened, poses)
    plan = plan_run(RunRequest(root, opened, terms, depth=depth, networks=networks))
    print_plan([plan], engine.jobs, root, dry_run)
    if dry_run:
        return
    prepared = prepare_run(plan, engine)
    if write_page := DEPTH_OUTPUTS.installed().get("depth page"):
        print(write_page(prepared, engine.jobs))
    if fuse:
        fused = DEPTH_OUTPUTS["fused instant"](prepared)
        print(fused.points, fused.mesh, sep="\n")
    if dense_workspace:
        print(DEPTH_OUTPUTS["dense workspace"](prepared, dense_workspace))


def render(
    run: Run,
    methods: Labels = USUAL_METHODS,
    weights: Weights = (),
    device: Device = "cpu",
    engine: Running = HERE,
) -> None:
    """Render all test views of a prepared run by each method.

    Args:
        run: run folder of `prepare`.
        methods: methods, or splats:PATH for fitted 3D Gaussians; finished renders are kept.
        weights: METHOD=FILE, the authors' checkpoint of a method without included weights.
        device: device of networks; GPU results can differ from the CPU's by 1/255 per pixel.
        engine: job execution.
    """
    from ggvs_eval.pipelines.run.evaluate import render as synthesise
    from ggvs_eval.pipelines.run.evaluate import reopen

    methods, splats = named_scenes(methods)
    networks = _networks(weights, device, splats)
    _require_methods(methods, networks)
    prepared = reopen(engine.place(run), engine, methods, networks)
    print(f"{synthesise(prepared, engine)} jobs rendered in {run}")


def score(
    folder: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None,
    renders: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="NAME=PATH ...", help_behavior_hint=NONE)
    ] = (),
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
    """Score all renders of a run, and your own, under one protocol.

    Args:
        folder: run folder to score; the same as --run.
        renders: your frames as a method NAME: folder, videos, arrays, archive or run
            (docs/guide.md).
        capture: rendered capture; creates a run folder of its frames if there is none.
        protocol: protocol (.toml or packaged name); the run's, else fitted to the capture.
        run: run folder to create or resume; scores/CAPTURE by default.
        allow_partial: score incomplete renders; their row is marked.
        link: link PNG files instead of copying them; the originals must stay.
        device: device of expensive metrics (LPIPS, SSIM, TCC, STED, ...); rounding differs by
            device.
        first_frame: number of the protocol's first frame in your file names, if ambiguous.
        with_truth: score renders against their own reference, without capture: .npz files
            (`renders`, `gts`, (T, H, W, 3)), or folders of renders/ and gt/.
        reading: capture reading.
        jobs: parallel processes, at least 1.
    """
    from ggvs_eval.pipelines.run.import_renders import (
        import_renders,
        named_renders,
        require_there,
        run_for,
    )
    from ggvs_eval.pipelines.run.own_truth import compare_published, run_with_truth
    from ggvs_eval.pipelines.run.score import require_labels
    from ggvs_eval.pipelines.run.score import score as measure
    from ggvs_eval.reports.tables_of_runs import scores_text

    if folder and run:
        raise ProtocolError(
            f"wanted one run folder, got {folder} and --run {run}; give one of them"
        )
    require_there(named := named_renders(renders))
    if with_truth and capture:
        raise ProtocolError(
            f"wanted --capture or --with-truth, got both; omit --with-truth to use {capture} as "
            f"the reference"
        )
    opened = partial(reading.open, capture) if capture else None
    root = run or folder
    with (
        run_with_truth(root, named, protocol)
        if with_truth
        else run_for(root, opened, protocol, jobs) as target
    ):
        for name, path in named.items():
            for note in import_renders(target, name, path, allow_partial, jobs, first_frame, link)[
                "notes"
            ]:
                print(f"{name}: {note}", file=sys.stderr)
        require_labels(target)
    results = measure(target, jobs, device=checked_device(device))
    print(scores_text(target.root))
    if with_truth:
        print(
            "own truth: measured against the images included with the renders, not against a "
            "capture"
        )
        print(*compare_published(named, results), sep="\n", end="\n" if named else "")
    for label, mark in results.partial.items():
        print(f"{label} is {mark}")
    for line in results.fault_lines():
        print(line)
    for metric, reason in results.not_computed.items():
        print(f"{metric} not computed: {reason}")
    lacking = dict.fromkeys(
        (absence.metric, absence.view or "all views of some methods", absence.reason)
        for absence in results.absences
    )
    for metric, where, reason in lacking:
        print(f"{metric} not computed in {where}: {reason}")
    print(f"scores are in {target.root}; the page: ggvs-eval report {target.root}", file=sys.stderr)


def merge(
    out: Output,
    runs: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="RUN RUN [RUN ...]", help_behavior_hint="(at least two)"),
    ],
    copy: bool = False,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Merge run folders of one capture and protocol into a new one.

    The runs can differ in methods and rendered views; shared results must be equal.

    Args:
        out: output run folder; written atomically.
        runs: run folders; unchanged.
        copy: copy files instead of linking them.
        jobs: parallel processes for missing scores, at least 1.
    """
    from ggvs_eval.pipelines.run.score import score
    from ggvs_eval.pipelines.sweep.merging.merge import merge_runs
    from ggvs_eval.reports.tables_of_runs import scores_text

    if len(runs) < 2:
        raise ResultsError(
            f"wanted at least two run folders to merge into {out}, got {len(runs)}; copy a single "
            f"one"
        )

    def finish(merged: RunFolder) -> None:
        missing = _missing_renders(merged)
        if missing:
            print(
                f"{out}: no table yet, {missing}; merge the runs with these, or render them here",
                file=sys.stderr,
            )
        else:
            score(merged, jobs)
            print(scores_text(merged.root))

    print(merge_runs(out, runs, copy, finish).root)


def run(
    run: Run,
    capture: Path | None = None,
    protocol: str | None = None,
    methods: Labels = USUAL_METHODS,
    weights: Weights = (),
    poses: Poses = None,
    device: Device = "cpu",
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = DEPTH_DEFAULTS,
    engine: Running = HERE,
    dry_run: bool = False,
) -> None:
    """Run the whole evaluation; a second call resumes.

    Steps: prepare, render, score, report.

    Args:
        run: run folder to create or resume.
        capture: folder of the capture; the included demo captures by default.
        protocol: protocol (.toml or packaged name); fitted to the capture by default.
        methods: methods, or [NAME=]splats:PATH for fitted 3D Gaussians (.ply, or a folder of them).
        weights: METHOD=FILE, the authors' checkpoint of a method without included weights.
        poses: cameras given, refined, or compare: refined if source cameras render better; the
            protocol's by default.
        device: device of networks; GPU results can differ from the CPU's by 1/255 per pixel.
        reading: capture reading.
        depth: depth estimation.
        engine: job execution.
        dry_run: print the remaining work, its disk use and estimated time, then exit.
    """
    from ggvs_eval.pipelines.run.evaluate import measure, report
    from ggvs_eval.pipelines.run.outlook import print_plan
    from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
    from ggvs_eval.pipelines.sweep.demo_runs import demo_plans, room_labels, run_demos, unpack_rooms
    from ggvs_eval.reports.tables_of_runs import scores_text

    methods, splats = named_scenes(methods)
    root, networks = engine.place(run), _networks(weights, device, splats)
    _require_methods(methods, networks)
    unpack = unpack_rooms(reading.open, dry_run)
    if capture is None and protocol is None:
        labels = room_labels(methods)
        run_demos(
            root,
            labels,
            demo_plans(root, labels, unpack, depth, networks, in_stages=not dry_run),
            engine,
            dry_run,
        )
        return
    opened = _open(reading, engine.place(capture), protocol) if capture else unpack.beside(root)
    terms = _protocol(protocol, opened, poses)
    plan = plan_run(
        RunRequest(
            root=root,
            capture=opened,
            protocol=terms,
            labels=methods,
            depth=depth,
            networks=networks,
        )
    )
    print_plan([plan], engine.jobs, root, dry_run)
    if dry_run:
        return
    results = measure(plan, engine)
    print(scores_text(plan.run.root))
    for line in results.fault_lines():
        print(line, file=sys.stderr)
    print(report([root]))


def sweep(
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP")],
    out: Output,
    capture: Annotated[
        tuple[Path, ...], tyro.conf.arg(metavar="CAPTURE ...", help_behavior_hint=NONE)
    ] = (),
    protocol: str | None = None,
    weights: Weights = (),
    poses: Poses = None,
    device: Device = "cpu",
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = DEPTH_DEFAULTS,
    engine: Running = HERE,
    shard: str = "1/1",
    plan: Path | None = None,
    dry_run: bool = False,
) -> None:
    """Evaluate the rows of a sweep in each variant, into one table.

    Failures are listed at the end and do not stop the rest; the same command retries only them.

    Args:
        name: packaged sweep (ablations, ablations_short, baselines, budget, k, offline, online,
            readings, sparse, stream, switches) or a .toml file.
        out: folder of the sweep; one run folder per variant, within a folder per capture if
            several.
        capture: one or more captures; the included demo by default.
        protocol: base protocol of the variants; fitted to the capture by default.
        weights: METHOD=FILE, the checkpoint of a method without included weights; else its rows are
            omitted.
        poses: cameras given, refined, or compare: refined if source cameras render better; the
            protocol's by default.
        device: device of networks; GPU results can differ from the CPU's by 1/255 per pixel.
        reading: capture reading.
        depth: depth estimation.
        engine: job execution.
        shard: i/n, part i of n machines (every n-th view); 0/n prepares for all. Run once more
            without it.
        plan: JSON file for the commands of the sweep and their order, instead of running it.
        dry_run: print the remaining work, its disk use and estimated time, then exit.
    """
    from ggvs_eval.jobs.shard import Shard
    from ggvs_eval.pipelines.run.outlook import print_plan
    from ggvs_eval.pipelines.sweep.demo_runs import unpack_rooms
    from ggvs_eval.pipelines.sweep.run_sweep import plan_cells, run_sweep
    from ggvs_eval.sweep import load_sweep

    definition, part = load_sweep(name), Shard.parse(shard)
    # planned commands may run if there is a GPU
    networks = _networks(weights, "cpu" if plan else device)
    user_captures = [_open(reading, engine.place(path), protocol) for path in capture]
    captures = user_captures or [
        unpack_rooms(reading.open, dry_run and plan is None).beside(engine.place(out))
    ]
    paths = [start.path for start in captures]
    opened = {start.path.resolve().name: start for start in captures}
    if len(opened) < len(capture):
        raise ProtocolError(
            f"wanted captures whose folders differ in name, got {', '.join(map(str, capture))}; "
            f"rename one"
        )
    starts = {
        folder if len(opened) > 1 else "": (start, _protocol(protocol, start, poses))
        for folder, start in opened.items()
    }
    if plan:
        options = [
            *changed_flags(reading, CAPTURE_DEFAULTS),
            *changed_flags(depth, DEPTH_DEFAULTS),
            *changed_flags(engine, HERE),
        ]
        flags = [
            *(["--protocol", protocol] if protocol else []),
            *(["--weights", *weights] if weights else []),
        ]
        flags += [
            *(["--device", device] if device != "cpu" else []),
            *(["--calibration", poses] if poses else []),
        ]
        command = [
            "ggvs-eval",
            "sweep",
            name,
            str(out),
            "--capture",
            *map(str, paths),
            *flags,
            *options,
        ]
        print(PLANS["commands"](plan, engine.place(out), starts, definition, networks, command))
        return
    planned = plan_cells(engine.place(out), starts, definition, depth, networks, part)
    print_plan(planned.plans, engine.jobs, engine.place(out), dry_run)
    if dry_run:
        _end_with(planned.failures, "the rest can be computed")
        return
    result = run_sweep(planned, engine)
    if not result.table.empty:
        scenes = {folder: (start.scene, base) for folder, (start, base) in starts.items()}
        table, sources = result.table, ()
        if "published" in LINES.present():
            lines, sources = LINES["published"](scenes, list(result.table.columns))
            table = result.with_lines(lines)
        print(table.round(4).to_string())
        print(*sources, sep="\n", end="\n" if sources else "")
    for title, reason in result.not_computed.items():
        print(f"{title} not computed: {reason}")
    _end_with(result.failures)


def status(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_SWEEP")],
) -> None:
    """Show progress, failures and disk use of a run or sweep.

    Works while the run is in progress.

    Args:
        folder: run folder, or folder of a sweep.
    """
    from ggvs_eval.pipelines.run.outlook import describe_outdated
    from ggvs_eval.pipelines.run.status import describe_status

    print(describe_status(folder))
    if outdated := describe_outdated([RunFolder(folder)]):
        print(f"{folder}: {outdated}; run `ggvs-eval run` to update")


def _end_with(
    failures: tuple[Failure, ...],
    advice: str = "the rest is finished; run the same command to retry these",
) -> None:
    """List what failed, bugs of the package with their tracebacks, and end with 1."""
    for failure in failures:
        print(failure.traceback or "", f"failed: {failure}", sep="", file=sys.stderr)
    if failures:
        sys.exit(f"ggvs-eval: {len(failures)} failed, listed above; {advice}")


def _networks(
    weights: tuple[str, ...], device: str, splats: Mapping[str, Path] = NO_SPLATS
) -> NetworkOptions:
    """METHOD=FILE, as often as wanted, files of Gaussians by their labels, and a device that is
    there.
    """
    return NetworkOptions(_checkpoints(weights), splats, checked_device(device))


def _require_methods(methods: Sequence[str], networks: NetworkOptions) -> None:
    """Refuse a mistyped method before anything is read."""
    for label in methods:
        for note in find_method(label, networks).notes:
            print(note, file=sys.stderr)


def _checkpoints(weights: tuple[str, ...]) -> dict[str, Path]:
    checkpoints: dict[str, Path] = {}
    for assignment in weights:
        method, equals, file = assignment.partition("=")
        if not equals or method not in METHODS or not Path(file).is_file():
            able = ", ".join(label for label in weights_takers() if "+" not in label)
            raise WeightsError(
                f"--weights {assignment}: wanted METHOD=FILE with one of {able} and a file that "
                f"exists"
            )
        checkpoints[method] = Path(file).resolve()
    return checkpoints


def _open(reading: CaptureOptions, path: Path, protocol: str | None) -> Capture:
    """Open a capture as its protocol wants it: with the cameras that are out of step where the
    protocol keeps them.
    """
    from ggvs_eval.pipelines.run.import_renders import asked_protocol

    keeps = protocol is not None and asked_protocol(protocol).views.keep_unsynced
    return (replace(reading, keep_unsynced=True) if keeps else reading).open(path)


def _protocol(
    source: str | None, capture: Capture, calibration: CalibrationChoice | None
) -> Protocol:
    from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
    from ggvs_eval.protocol import load_protocol

    protocol = load_protocol(source) if source else suggest_protocol(capture)
    if calibration in (None, protocol.synthesis.calibration):
        return protocol
    return replace(protocol, synthesis=replace(protocol.synthesis, calibration=calibration))


def _missing_renders(run: RunFolder) -> str:
    """Return the views that methods of a merged run lack, as text; empty if nothing is missing."""
    from ggvs_eval.coverage import read_import

    views = run.protocol().views.test
    labels = [label for label in run.labels() if read_import(run, label) is None]
    lacking = {
        label: [view for view in views if not run.renders(label, view).is_dir()] for label in labels
    }
    return "; ".join(f"{label} lacks {', '.join(some)}" for label, some in lacking.items() if some)
