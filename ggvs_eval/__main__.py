"""``python -m ggvs_eval`` and the ``ggvs-eval`` command."""

import sys


def main() -> None:
    """Hand over to the command line."""
    try:
        from ggvs_eval.pipelines.commands.main import run_command
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("ggvs_eval."):
            raise
        sys.exit("ggvs-eval: this checkout is not installed; run `make reports` or `pip install -e .`")
    run_command()


if __name__ == "__main__":
    main()
