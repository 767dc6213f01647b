"""``python -m ggvs_eval`` and the ``ggvs-eval`` command."""

import os
import signal
import sys
from collections.abc import Callable

INTERRUPTED = 128 + signal.SIGINT
STOPPED = "ggvs-eval: stopped; finished work is kept; run the same command to resume"


def main() -> None:
    """Hand over to the command line; Ctrl-C and SIGTERM end it with one line and 130.

    Reading:
        A request to terminate ends as Ctrl-C does, with 130 too and not the shell's 143: in both
        cases the user stopped it and the same command continues; a scheduler that terminates jobs
        knows from its own record that it did.
    """
    _on_stop(_end_at_once)
    run_command = _command_line()
    _on_stop(signal.default_int_handler)
    try:
        run_command()
    except KeyboardInterrupt:
        print(STOPPED, file=sys.stderr)
        sys.exit(INTERRUPTED)


def _on_stop(handle: Callable[..., object]) -> None:
    """Install a handler of SIGINT (Ctrl-C) and SIGTERM, except where the process that started this
    one has them ignored.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handle)


def _end_at_once(*_: object) -> None:
    """Nothing is begun yet, and a module that is being imported may swallow an exception."""
    print(STOPPED, file=sys.stderr, flush=True)
    os._exit(INTERRUPTED)


def _command_line() -> Callable[[], None]:
    try:
        from ggvs_eval.pipelines.commands.main import run_command
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("ggvs_eval."):
            raise
        sys.exit(
            "ggvs-eval: this checkout is not installed; run `make reports` or `pip install -e .`"
        )
    return run_command


if __name__ == "__main__":
    main()
