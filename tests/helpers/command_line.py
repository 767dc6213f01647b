"""The command line as a user calls it, for tests of what it refuses."""

import pytest

from ggvs_eval.pipelines.commands.main import run_command


def refusal(*arguments: object) -> str:
    """The one line with which `ggvs-eval ARGUMENTS` ends."""
    with pytest.raises(SystemExit) as caught:
        run_command([str(argument) for argument in arguments])
    message = str(caught.value.code)
    assert message.startswith("ggvs-eval: ")
    assert "\n" not in message
    return message
