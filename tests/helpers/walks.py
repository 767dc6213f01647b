"""Pages that are followed literally: their blocks of shell commands, and what each command did."""

import contextlib
import io
import re
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.finding import Finding
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.run_folder import read_json

# They take --jobs; processes would only take longer to start here.
IN_ONE_PROCESS = ("check", "run", "view", "score", "doctor")


@dataclass(frozen=True)
class Step:
    """One command of a page.

    Attributes:
        command: as it stands there.
        exit_code: with which it ended, or its message.
        output: what it printed.
        findings: what ``rig.check.json`` held then.
    """

    command: str
    exit_code: int | str | None
    output: str
    findings: tuple[Finding, ...]

    def of(self, question: str, camera: str) -> Finding:
        return next(
            each for each in self.findings if (each.question, each.subject) == (question, camera)
        )


def commands_of(page: Path) -> list[str]:
    """The lines of all blocks of shell commands."""
    blocks = re.findall(
        r"^```sh\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    return [line for block in blocks for line in block.splitlines() if line.strip()]


def follow(line: str) -> Step:
    """Do what a line says, in the current folder."""
    words, output = shlex.split(line, comments=True), io.StringIO()
    code: int | str | None = 0
    if words[0] != "ggvs-eval":
        subprocess.run(words, check=True)
        return Step(line, 0, "", ())
    more = ["--jobs", "1"] if words[1] in IN_ONE_PROCESS else []
    with contextlib.redirect_stdout(output):
        try:
            run_command([*words[1:], *more])
        except SystemExit as ended:
            code = ended.code
    checked = Path("rig.check.json")
    findings = (
        tuple(Finding(**each) for each in read_json(checked)["findings"])
        if checked.is_file()
        else ()
    )
    return Step(line, code, output.getvalue(), findings)
