"""The command line. Errors of user and machine are one line and exit code 1.

Bugs keep their traceback.
"""

import codecs
import inspect
import io
import os
import re
import sys
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from shutil import get_terminal_size
from typing import Any, TextIO

from ggvs_eval import __version__
from ggvs_eval.built_in import VERBS
from ggvs_eval.errors import CommandError, GgvsError, GgvsWarning, did_you_mean, mendable
from ggvs_eval.plugins import Registry, use_file

Command = Callable[..., Any]
Commands = Mapping[str, "Command | Commands"]


# A verb is loaded when it is called; `train` has a subcommand for each network.
COMMANDS: Registry["Command | Commands"] = Registry(
    "commands", {name: verb.target for name, verb in VERBS.items()}
)
WIDEST = 100  # of the overview's lines, in characters
PLUGIN = "--plugin"  # of any verb: a file with metrics, methods or layouts of the user's own
# how stdout writes what it cannot
PLAIN, PLAIN_SIGNS = "ggvs-eval-plain", str.maketrans("─━–—−±×·", "-----~x.")
# the second and later lines of an argument in a docstring
CONTINUED = re.compile(r"\n {12,}(?=\S)")
ABOUT = {
    "ggvs-eval": "Evaluate multi-view 3D video synthesis. "
    "Every command also takes --plugin FILE.py: metrics, methods and layouts of your own.",
    "ggvs-eval train": "Train a network of this package; a second call resumes.",
}


def run_command(arguments: list[str] | None = None) -> None:
    """Parse the command line and run the command."""
    warnings.showwarning = _show_warning
    codecs.register_error(PLAIN, _plain)
    if sys.stdout is None:  # closed by who started this, `>&-`
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - as long as the process
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors=PLAIN)  # of cron and containers, which may know ASCII alone
    try:
        call_command(
            "ggvs-eval",
            COMMANDS,
            _without_plugins(sys.argv[1:] if arguments is None else arguments),
        )
        sys.stdout.flush()
    except BrokenPipeError:  # `ggvs-eval ... | head`
        _forget_output()
        sys.exit(1)
    except (GgvsError, OSError, MemoryError) as error:
        try:
            sys.stdout.flush()
        except OSError:  # the full disk is that of the output
            _forget_output()
        sys.exit(f"ggvs-eval: {mendable(error)}")


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Write what a terminal lacks by what is nearest to it."""
    assert isinstance(error, UnicodeEncodeError)
    return error.object[error.start : error.end].translate(PLAIN_SIGNS).encode(
        "ascii", "replace"
    ).decode(), error.end


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Write this package's warnings like its errors, without the place in the code.

    Others as usual.
    """
    is_package_warning = issubclass(category, GgvsWarning)
    text = (
        f"ggvs-eval: {message}"
        if is_package_warning
        else warnings.formatwarning(message, category, filename, lineno, line)
    )
    print(text, file=file or sys.stderr, flush=True)


def _without_plugins(words: Sequence[str]) -> list[str]:
    """Return the command line without ``--plugin FILE.py``, which any verb takes.

    The files' objects are known from then on.
    """
    left = list(words)
    while PLUGIN in left:
        at = left.index(PLUGIN)
        if at + 1 == len(left):
            raise CommandError(f"{PLUGIN}: wanted a file after it, such as my_metrics.py")
        use_file(Path(left[at + 1]))
        del left[at : at + 2]
    return left


def _forget_output() -> None:
    """Drop what is still buffered, which must not fail again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def call_command(program: str, commands: Commands, words: Sequence[str]) -> None:
    """Call the command that the first word names with the options that follow it.

    Each command has its own parser, so that a mistyped option is compared with the options of that
    command alone.

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
    if not words or words[0] in ("-h", "--help"):
        print(_overview(program, commands), file=sys.stdout if words else sys.stderr)
        sys.exit(0 if words else 2)
    name = words[0]
    try:
        command = commands[name]
    except KeyError:
        called, suggestion = " ".join([*program.split()[1:], name]), did_you_mean(name, commands)
        raise CommandError(
            f"no command {called!r}; commands are {', '.join(commands)}{suggestion}"
        ) from None
    if isinstance(command, Mapping):
        call_command(f"{program} {name}", command, words[1:])
    else:
        import tyro  # not before a command is called

        called = f"{program} {name}"
        # tyro would break help where the source does
        command.__doc__ = CONTINUED.sub(" ", command.__doc__ or "")
        verb = VERBS.get(called.split()[1])
        # a plug-in's has none
        example = f"\n\nExample: {called} {verb.example.replace('NETWORK', name)}" if verb else ""
        tyro.cli(
            command,
            prog=called,
            args=words[1:],
            description=_about(command) + example,
            config=(tyro.conf.DisallowNone,),
        )


def _about(command: Callable[..., None]) -> str:
    """Return the paragraphs of a command's docstring before its arguments, each on one line."""
    text = inspect.cleandoc(command.__doc__ or "").partition("\n\nArgs:")[0]
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


def _overview(program: str, commands: Commands) -> str:
    """Return the commands of a program by their groups, each with its line of help.

    Of what ships nothing is loaded.
    """
    groups: dict[str, dict[str, str]] = {}
    for name in commands:
        verb = VERBS.get(name) if commands is COMMANDS else None
        about = verb.about if verb else (commands[name].__doc__ or "").partition("\n")[0]
        groups.setdefault(verb.group if verb else "networks", {})[name] = about
    width = min(get_terminal_size().columns, WIDEST)
    column = max(map(len, commands)) + 4
    lines = [f"usage: {program} [-h] COMMAND ...", "", *textwrap.wrap(ABOUT[program], width)]
    for group, abouts in groups.items():
        lines += ["", f"{group}:"]
        for name, about in abouts.items():
            lines += textwrap.wrap(
                about,
                width,
                initial_indent=f"  {name}".ljust(column),
                subsequent_indent=column * " ",
            )
    return "\n".join([*lines, "", f"`{program} COMMAND --help` shows the options of a command."])
