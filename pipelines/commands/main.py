"""The command line. Errors of the user and of the machine are one line and exit code 1; our bugs keep their traceback."""

import codecs
import inspect
import io
import os
import re
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TextIO, Union

import tyro

from ggvs_eval import __version__
from ggvs_eval.errors import CommandError, GgvsError, GgvsWarning, ProtocolError, did_you_mean, mendable
from ggvs_eval.pipelines.commands.captures import (
    CAPTURE_DEFAULTS,
    NONE,
    ONE_PER_CORE,
    CaptureFlags,
    Jobs,
    calibrate,
    check,
    demo,
    get,
    protocol,
    undistort,
)
from ggvs_eval.pipelines.commands.examples import EXAMPLES
from ggvs_eval.pipelines.commands.export import export
from ggvs_eval.pipelines.commands.figures import compare, figure, report
from ggvs_eval.pipelines.commands.merge import merge
from ggvs_eval.pipelines.commands.play import play, view
from ggvs_eval.pipelines.commands.renders import doctor, explain
from ggvs_eval.pipelines.commands.runs import Device, prepare, render, run, status, sweep
from ggvs_eval.pipelines.commands.steadiness import steadiness
from ggvs_eval.pipelines.commands.study import metric_study
from ggvs_eval.pipelines.commands.training import TRAININGS
from ggvs_eval.pipelines.methods.network_options import checked_device
from ggvs_eval.plugins import use_file


def score(
    folder: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None,
    renders: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=PATH ...", help_behavior_hint=NONE)] = (),
    capture: Path | None = None,
    protocol: str | None = None,
    run: Path | None = None,
    allow_partial: bool = False,
    device: Device = "cpu",
    first_frame: int | None = None,
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
        device: where LPIPS, SSIM, TCC, STED and other metrics of many operations compute; a GPU rounds otherwise than the CPU.
        first_frame: number of the protocol's first frame in the names of your frames (its place, from 0, in videos and arrays);
            needed where the numbers can be read in two ways.
        reading: how the capture is read.
        jobs: processes.
    """
    from ggvs_eval.pipelines.run.import_renders import import_renders
    from ggvs_eval.pipelines.run.run_for import named_renders, run_for
    from ggvs_eval.pipelines.run.score import score as measure

    if folder and run:
        raise ProtocolError(f"wanted one run folder, got {folder} and --run {run}; give one of them")
    target = run_for(run or folder, partial(reading.open, capture) if capture else None, protocol, jobs)
    for name, path in named_renders(renders).items():
        for note in import_renders(target, name, path, allow_partial, jobs, first_frame)["notes"]:
            print(f"{name}: {note}", file=sys.stderr)
    results = measure(target, jobs, device=checked_device(device))
    print(results.summary().droplevel("dataset").round(4).to_string())
    for label, mark in results.provenance["partial"].items():
        print(f"{label} is {mark}")
    for line in results.fault_lines():
        print(line)
    for metric, reason in results.not_computed.items():
        print(f"{metric} not computed: {reason}")
    lacking = dict.fromkeys((one.metric, one.view or "all views of some methods", one.reason) for one in results.absences)
    for metric, where, reason in lacking:
        print(f"{metric} not computed in {where}: {reason}")


Command = Callable[..., Any]
Commands = Mapping[str, "Command | Commands"]

# `train` has a subcommand for each network.
COMMANDS: Commands = {
    "demo": demo,
    "get": get,
    "check": check,
    "calibrate": calibrate,
    "undistort": undistort,
    "protocol": protocol,
    "prepare": prepare,
    "render": render,
    "score": score,
    "merge": merge,
    "report": report,
    "figure": figure,
    "compare": compare,
    "run": run,
    "sweep": sweep,
    "status": status,
    "play": play,
    "view": view,
    "export": export,
    "train": TRAININGS,
    "doctor": doctor,
    "explain": explain,
    "steadiness": steadiness,
    "metric-study": metric_study,
}
PLUGIN = "--plugin"  # of any verb: a file with metrics, methods or layouts of the user's own
PLAIN, PLAIN_SIGNS = "ggvs-eval-plain", str.maketrans("─━–—−±×·", "-----~x.")  # how stdout writes what it cannot
CONTINUED = re.compile(r"\n {12,}(?=\S)")  # the second and later lines of an argument in a docstring
ABOUT = {
    "ggvs-eval": "How good and how steady, over views and over time, is a method on a multi-view capture - and why? "
    "Every command also takes --plugin FILE.py: metrics, methods and layouts of your own.",
    "ggvs-eval train": "Train a network of this package; a second call goes on where the first one stopped.",
}


def run_command(arguments: list[str] | None = None) -> None:
    """Parse the command line and do what it says."""
    warnings.showwarning = _show_warning
    codecs.register_error(PLAIN, _plain)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors=PLAIN)  # of cron and containers, which may know ASCII alone
    try:
        call_command("ggvs-eval", COMMANDS, _without_plugins(sys.argv[1:] if arguments is None else arguments))
        sys.stdout.flush()
    except BrokenPipeError:  # `ggvs-eval ... | head`
        _forget_output()
        sys.exit(1)
    except (GgvsError, OSError) as error:
        try:
            sys.stdout.flush()
        except OSError:  # the full disk is that of our output
            _forget_output()
        sys.exit(f"ggvs-eval: {mendable(error)}")


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Write what a terminal lacks by what is nearest to it."""
    assert isinstance(error, UnicodeEncodeError)
    return error.object[error.start : error.end].translate(PLAIN_SIGNS).encode("ascii", "replace").decode(), error.end


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Write our warnings as our errors are written, without the place in the code; those of others as ever."""
    ours = issubclass(category, GgvsWarning)
    shown = f"ggvs-eval: {message}" if ours else warnings.formatwarning(message, category, filename, lineno, line)
    print(shown, file=file or sys.stderr, flush=True)


def _without_plugins(words: Sequence[str]) -> list[str]:
    """The command line without ``--plugin FILE.py``, which any verb takes; the files' objects are known from then on."""
    left = list(words)
    while PLUGIN in left:
        at = left.index(PLUGIN)
        if at + 1 == len(left):
            raise CommandError(f"{PLUGIN}: wanted a file behind it, such as my_metrics.py")
        use_file(Path(left[at + 1]))
        del left[at : at + 2]
    return left


def _forget_output() -> None:
    """Drop what is still buffered, which must not fail again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def call_command(program: str, commands: Commands, words: Sequence[str]) -> None:
    """Call the command that the first word names with the options that follow it.

    Each command has a parser of its own, so that a mistyped option is compared with the options of that command alone.

    Args:
        program: the words before, for messages.
        commands: what may be called.
        words: the rest of the command line; without a command it is answered by the overview.

    Raises:
        CommandError: no command of that name; the message suggests the nearest one.
    """
    if list(words) == ["--version"]:
        print(f"ggvs-eval {__version__}")
        return
    if not words or words[0].startswith("-"):
        tyro.cli(_any_of(program, commands), prog=program, description=ABOUT[program], args=words)  # prints and exits
        return
    name = words[0]
    if name not in commands:
        suggestion = did_you_mean(name, commands)
        raise CommandError(f"no command {name!r} of {program}; there are {', '.join(commands)}{suggestion}")
    command = commands[name]
    if isinstance(command, Mapping):
        call_command(f"{program} {name}", command, words[1:])
    else:
        called = f"{program} {name}"
        command.__doc__ = CONTINUED.sub(" ", command.__doc__ or "")  # tyro would break help where the source does
        about = f"{_about(command)}\n\nExample: {called} {EXAMPLES[called]}"
        tyro.cli(command, prog=called, args=words[1:], description=about, config=(tyro.conf.DisallowNone,))


def _about(command: Callable[..., None]) -> str:
    """The paragraphs of a command's docstring before its arguments, each on one line."""
    text = inspect.cleandoc(command.__doc__ or "").partition("\n\nArgs:")[0]
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


def _any_of(program: str, commands: Commands) -> Any:
    """The type by which tyro lists commands, each with the first sentence of its docstring."""
    choices = []
    for name, command in commands.items():
        if isinstance(command, Mapping):
            inner = f"{program} {name}"
            choices.append(Annotated[_any_of(inner, command), tyro.conf.subcommand(name=name, description=ABOUT[inner])])
        else:
            about = (command.__doc__ or "").partition("\n")[0]
            choices.append(Annotated[Any, tyro.conf.subcommand(name=name, constructor=command, description=about)])
    return Union[tuple(choices)]  # noqa: UP007 - the number of its members is known when it is made
