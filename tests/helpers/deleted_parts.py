"""Code for a process whose package lacks parts; in a checkout an editable install would find again
what was taken away.
"""

# Runs commands in one process: command -> exit status or message, and what it wrote.
RUN_COMMANDS = """
import contextlib, io, json, sys
sys.meta_path[:] = [finder for finder in sys.meta_path if not getattr(finder, "__module__", "").startswith("__editable__")]
from ggvs_eval.pipelines.commands.main import run_command

def run_commands(commands):
    ended = {}
    for command in commands:
        output, code = io.StringIO(), 0
        with contextlib.redirect_stdout(output):
            try:
                run_command(command.split())
            except SystemExit as end:
                code = end.code
        ended[command] = [code, output.getvalue()]
    return ended
"""  # noqa: E501
