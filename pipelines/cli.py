"""The command line. Known errors are one line and exit code 1; anything else is our bug and keeps its traceback."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ggvs_eval.errors import GgvsError, ProtocolError
from ggvs_eval.pipelines.methods import METHODS
from ggvs_eval.processes import default_workers
from ggvs_eval.synthetic.options import DemoOptions

Folder = Annotated[Path, tyro.conf.Positional]
Labels = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")]
ALL_METHODS = tuple(METHODS)


def demo(out: Folder, options: tyro.conf.OmitArgPrefixes[DemoOptions] = DemoOptions()) -> None:  # noqa: B008 - frozen
    """Write the demo capture: a procedural dynamic room in DyNeRF's layout, with exact depth beside it.

    Args:
        out: folder to write; absent, or holding this very demo.
        options: what the room, the rig and the sensors are like.
    """
    from ggvs_eval.synthetic.demo import write_demo

    print(write_demo(out, options, default_workers()))


def prepare(run: Folder, capture: Path, protocol: str | None = None, jobs: int = default_workers()) -> None:
    """Read a capture under a protocol and write what every method needs: truth frames, source views, depth.

    Args:
        run: run folder to make or to go on with.
        capture: folder of the capture; its layout is detected.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        jobs: processes.
    """
    from ggvs_eval.pipelines.prepare import prepare as write

    print(write(run, capture, _protocol(protocol, capture), jobs).run.root)


def render(run: Folder, methods: Labels = ALL_METHODS, jobs: int = default_workers()) -> None:
    """Synthesise every test view of a prepared run by each method.

    Args:
        run: run folder that `prepare` has made.
        methods: which methods; what is rendered already is left alone.
        jobs: processes.
    """
    from ggvs_eval.pipelines.evaluate import reopen
    from ggvs_eval.pipelines.render import render as synthesise

    print(f"{synthesise(reopen(run, jobs), methods, jobs)} jobs rendered in {run}")


def score(run: Folder, renders: tuple[str, ...] = (), jobs: int = default_workers()) -> None:
    """Measure all renders of a run, and frames that others rendered, under the run's protocol.

    Args:
        run: run folder that `prepare` has made.
        renders: NAME=FOLDER of your own frames, FOLDER/<view>/<frame>.png with four digits; they become a method of the run.
        jobs: processes.
    """
    from ggvs_eval.pipelines.score import import_renders
    from ggvs_eval.pipelines.score import score as measure
    from ggvs_eval.run_folder import RunFolder

    for item in renders:
        name, separator, folder = item.partition("=")
        if not separator:
            raise ProtocolError(f"--renders wants NAME=FOLDER, got {item!r}")
        import_renders(RunFolder(run), name, Path(folder))
    results = measure(RunFolder(run), jobs)
    print(results.summary().droplevel("dataset").round(4).to_string())
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
    methods: Labels = ALL_METHODS,
    jobs: int = default_workers(),
) -> None:
    """Do it all: prepare, render, score, report. A second call does only what is missing.

    Args:
        run: run folder to make or to go on with.
        capture: folder of the capture; without one the demo capture is made beside the run folder.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        methods: which methods.
        jobs: processes.
    """
    from ggvs_eval.pipelines.evaluate import evaluate

    if capture is None:
        from ggvs_eval.synthetic.demo import write_demo

        capture = write_demo(run.with_name(f"{run.name}-capture"), DemoOptions(), jobs)
    print(evaluate(run, capture, _protocol(protocol, capture), methods, jobs))


COMMANDS: dict[str, Callable[..., Any]] = {
    "demo": demo,
    "prepare": prepare,
    "render": render,
    "score": score,
    "report": report,
    "slice": draw_slice,
    "run": run,
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


def _protocol(source: str | None, capture: Path) -> Any:
    from ggvs_eval.pipelines.evaluate import suggest_protocol
    from ggvs_eval.protocol import load_protocol

    return load_protocol(source) if source else suggest_protocol(capture)
