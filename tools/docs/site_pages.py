"""Pages of the site that are made from the code while it is built; a hook of MkDocs."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from ggvs_eval.built_in import VERBS
from ggvs_eval.pipelines.commands.main import COMMANDS, run_command

sys.path.insert(0, str(Path(__file__).parent))  # MkDocs loads a hook as a file of its own
from describe_code import ROOT, rooms_table

WIDTH = "80"  # of a command's help, in signs


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference of the command line and the page of rooms."""
    files.append(File.generated(config, "cli.md", content=command_reference()))
    files.append(File.generated(config, "rooms.md", content=f"# Rooms\n\n{rooms_table(ROOT)}\n"))
    return files


def command_reference() -> str:
    """The help of every command, by groups, as Markdown."""
    lines = ["# Command line", "", "Generated from `ggvs-eval COMMAND --help`.", ""]
    group = ""
    for name, verb in VERBS.items():
        if verb.group != group:
            group = verb.group
            lines += [f"## {group[0].upper()}{group[1:]}", ""]
        for words in _commands((name,), COMMANDS[name]):
            lines += [f"### {' '.join(words)}", "", "```text", _help(words), "```", ""]
    return "\n".join(lines)


def _commands(words: tuple[str, ...], command: Any) -> Iterator[tuple[str, ...]]:
    if not isinstance(command, Mapping):
        yield words
        return
    for name in command:
        yield from _commands((*words, name), command[name])


def _help(words: tuple[str, ...]) -> str:
    """What a command prints for ``--help``."""
    printed = io.StringIO()
    os.environ["COLUMNS"] = WIDTH
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        run_command([*words, "--help"])
    return printed.getvalue().strip()
