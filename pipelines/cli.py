"""The command line. Known errors are one line and exit code 1; anything else is our bug and keeps its traceback."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ggvs_eval.capture import Capture
from ggvs_eval.errors import GgvsError, ProtocolError
from ggvs_eval.pipelines.cli_captures import (
    BY_DEFAULT,
    FOUND_BY_DEFAULT,
    Finding,
    Folder,
    Reading,
    calibrate,
    check,
    demo,
    undistort,
)
from ggvs_eval.pipelines.cli_play import play
from ggvs_eval.pipelines.cli_renders import doctor, explain
from ggvs_eval.pipelines.cli_training import train
from ggvs_eval.pipelines.methods import METHODS, usual_methods
from ggvs_eval.processes import default_workers
from ggvs_eval.protocol import Protocol
from ggvs_eval.synthetic.options import DemoOptions

Labels = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")]
USUAL_METHODS = usual_methods()


def prepare(
    run: Folder,
    capture: Path,
    protocol: str | None = None,
    fuse: bool = False,
    dense_workspace: Path | None = None,
    reading: Reading = BY_DEFAULT,
    depth: Finding = FOUND_BY_DEFAULT,
    jobs: int = default_workers(),
) -> None:
    """Read a capture under a protocol and write what every method needs: truth frames, source views, depth, a page that shows it.

    Args:
        run: run folder to make or to go on with.
        capture: folder of the capture; its layout is detected.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        fuse: also fuse the first instant into a point cloud and a mesh, RUN/fused/<frame>/{points,mesh}.ply.
        dense_workspace: also write the first instant's depth as a COLMAP dense workspace into this folder.
        reading: how the capture is read.
        depth: how depth is found.
        jobs: processes.
    """
    from ggvs_eval.pipelines.depth_outputs import export_prepared, fuse_prepared, write_prepared_page
    from ggvs_eval.pipelines.prepare import prepare as write

    opened = reading.open(capture)
    prepared = write(run, opened, _protocol(protocol, opened), jobs, depth)
    print(write_prepared_page(prepared, depth.options().filled_confidence, jobs))
    if fuse:
        fused = fuse_prepared(prepared)
        print(fused.points, fused.mesh, sep="\n")
    if dense_workspace:
        print(export_prepared(prepared, dense_workspace))


def render(run: Folder, methods: Labels = USUAL_METHODS, jobs: int = default_workers()) -> None:
    """Synthesise every test view of a prepared run by each method.

    Args:
        run: run folder that `prepare` has made.
        methods: which methods; what is rendered already is left alone.
        jobs: processes.
    """
    from ggvs_eval.pipelines.evaluate import reopen
    from ggvs_eval.pipelines.render import render as synthesise

    print(f"{synthesise(reopen(run, jobs), methods, jobs)} jobs rendered in {run}")


def score(
    folder: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")] = None,
    renders: tuple[str, ...] = (),
    capture: Path | None = None,
    protocol: str | None = None,
    run: Path | None = None,
    allow_partial: bool = False,
    reading: Reading = BY_DEFAULT,
    jobs: int = default_workers(),
) -> None:
    """Measure all renders of a run, and frames that others rendered, under one protocol.

    Args:
        folder: run folder to score; --run says the same.
        renders: NAME=PATH of your own frames, which become a method of the run: a folder <view>/<frame>.png or .jpg, a video
            or numpy stack per view, renders/ beside gt/ as 3DGS writes them, a run folder, NerfBaselines output, or an archive.
        capture: what was rendered; makes a run folder of its captured frames where there is none.
        protocol: a .toml file or a packaged name; the run's own, or the packaged one that fits the capture, by default.
        run: run folder to make or to go on with; scores/CAPTURE by default.
        allow_partial: score what there is of incomplete renders; their row is marked.
        reading: how the capture is read.
        jobs: processes.
    """
    from ggvs_eval.pipelines.renders.import_renders import import_renders
    from ggvs_eval.pipelines.renders.run_for import named_renders, run_for
    from ggvs_eval.pipelines.score import score as measure

    if folder and run:
        raise ProtocolError(f"wanted one run folder, got {folder} and --run {run}; give one of them")
    target = run_for(run or folder, reading.open(capture) if capture else None, protocol, jobs)
    for name, path in named_renders(renders).items():
        for note in import_renders(target, name, path, allow_partial, jobs)["notes"]:
            print(f"{name}: {note}", file=sys.stderr)
    results = measure(target, jobs)
    print(results.summary().droplevel("dataset").round(4).to_string())
    for label, mark in results.provenance["partial"].items():
        print(f"{label} is {mark}")
    for metric, reason in results.not_computed.items():
        print(f"{metric} not computed: {reason}")


def report(runs: Annotated[tuple[Path, ...], tyro.conf.Positional], out: Path | None = None) -> None:
    """Write the page, the tables (Markdown, CSV, LaTeX) and the figures of scored runs.

    Args:
        runs: run folders of one protocol.
        out: folder to write; RUN/report of the first run by default.
    """
    from ggvs_eval.pipelines.evaluate import report as write

    print(write(runs, out))


def draw_slice(run: Folder, kind: Literal["epi", "time"], out: Path, row: int | None = None, view: str | None = None) -> None:
    """Draw an epipolar plane image or an x-t slice of every method beside the truth.

    Args:
        run: run folder with renders.
        kind: epi: one image row along a horizontal camera path; time: one image row of one view along time.
        out: PNG to write.
        row: image row; the most telling one by default.
        view: test view of a time slice; the first by default.
    """
    from ggvs_eval.reports.slices import write_slices

    print(write_slices(run, kind, row, view, out))


def run(
    run: Folder,
    capture: Path | None = None,
    protocol: str | None = None,
    methods: Labels = USUAL_METHODS,
    reading: Reading = BY_DEFAULT,
    depth: Finding = FOUND_BY_DEFAULT,
    jobs: int = default_workers(),
) -> None:
    """Do it all: prepare, render, score, report. A second call does only what is missing.

    Args:
        run: run folder to make or to go on with.
        capture: folder of the capture; without one the demo capture is made beside the run folder.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        methods: which methods.
        reading: how the capture is read.
        depth: how depth is found.
        jobs: processes.
    """
    from ggvs_eval.pipelines.evaluate import evaluate

    opened = reading.open(capture or _demo_beside(run, jobs))
    print(evaluate(run, opened, _protocol(protocol, opened), methods, jobs, depth))


def sweep(
    name: Annotated[str, tyro.conf.Positional],
    out: Folder,
    capture: tuple[Path, ...] = (),
    protocol: str | None = None,
    reading: Reading = BY_DEFAULT,
    depth: Finding = FOUND_BY_DEFAULT,
    jobs: int = default_workers(),
) -> None:
    """Evaluate every row of a sweep under each of its variants and print one table of all.

    Args:
        name: a packaged sweep (ablations, k, online, readings) or a .toml file.
        out: folder of the sweep; each variant is a run folder in it, of several captures in a folder called like the capture.
        capture: folder of the capture, or of several, whose means then stand beside them; without one the demo capture is made.
        protocol: what the variants start from; by default the packaged one that fits the capture.
        reading: how the capture is read.
        depth: how depth is found.
        jobs: processes.
    """
    from ggvs_eval.pipelines.sweep import run_sweep, run_sweeps
    from ggvs_eval.sweep import load_sweep

    wanted = load_sweep(name)
    opened = {path.resolve().name: reading.open(path) for path in capture or (_demo_beside(out, jobs),)}
    if len(opened) < len(capture):
        raise ProtocolError(f"wanted captures whose folders differ in name, got {', '.join(map(str, capture))}; rename one")
    starts = {folder: (each, _protocol(protocol, each)) for folder, each in opened.items()}
    if len(starts) > 1:
        result = run_sweeps(out, starts, wanted, jobs, depth)
    else:
        ((only, start),) = starts.values()
        result = run_sweep(out, only, wanted, start, jobs, depth)
    print(result.table.round(4).to_string())
    for title, reason in result.not_computed.items():
        print(f"{title} not computed: {reason}")


COMMANDS: dict[str, Callable[..., Any]] = {
    "demo": demo,
    "check": check,
    "calibrate": calibrate,
    "undistort": undistort,
    "prepare": prepare,
    "render": render,
    "score": score,
    "report": report,
    "slice": draw_slice,
    "run": run,
    "sweep": sweep,
    "play": play,
    "train": train,
    "doctor": doctor,
    "explain": explain,
}


def run_command(arguments: list[str] | None = None) -> None:
    """Parse the command line and do what it says."""
    try:
        tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="ggvs-eval",
            description="How good and how steady, over views and over time, is a method on a multi-view capture - and why?",
            args=arguments,
        )
    except GgvsError as error:
        sys.exit(f"ggvs-eval: {error}")
    except BrokenPipeError:  # `ggvs-eval ... | head`; what is still buffered must not fail at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _demo_beside(run: Path, jobs: int) -> Path:
    from ggvs_eval.synthetic.demo import write_demo

    return write_demo(run.with_name(f"{run.name}-capture"), DemoOptions(), jobs)


def _protocol(source: str | None, capture: Capture) -> Protocol:
    from ggvs_eval.pipelines.suggest_protocol import suggest_protocol
    from ggvs_eval.protocol import load_protocol

    return load_protocol(source) if source else suggest_protocol(capture)
