"""The verb of the command line that compares runs."""

from pathlib import Path
from typing import Annotated

import tyro


def compare(
    first: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="A")],
    second: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="B")],
    run: Path | None = None,
    views: bool = False,
    csv: Path | None = None,
) -> None:
    """Compare two runs, or two methods of a run, with paired tests.

    Args:
        first: run folder, or a method with --run.
        second: second run or method; differences are first minus second.
        run: run folder of both methods.
        views: also compare each view alone.
        csv: CSV file for all differences, unrounded, per view too.
    """
    from ggvs_eval.reports.tables.compare_runs import write_comparison

    print(write_comparison(first, second, run, views, csv))
