"""``python -m ggvs_eval`` and the ``ggvs-eval`` command."""

import signal
import sys

INTERRUPTED = 128 + signal.SIGINT


def main() -> None:
    """Hand over to the command line; Ctrl-C and SIGTERM end it with one line and 130.

    Reading:
        A request to terminate ends as Ctrl-C does, with 130 too and not the shell's 143: both say that the user stopped it and that
        the same command goes on. What asks for 143, a scheduler, sees by its own record that it sent the signal.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # raises KeyboardInterrupt
    try:
        _run()
    except KeyboardInterrupt:
        print("ggvs-eval: stopped; what is done stays, the same command goes on from there", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _run() -> None:
    try:
        from ggvs_eval.pipelines.commands.main import run_command
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("ggvs_eval."):
            raise
        sys.exit("ggvs-eval: this checkout is not installed; run `make reports` or `pip install -e .`")
    run_command()


if __name__ == "__main__":
    main()
