"""The verb of the command line that compares runs."""

from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.pipelines.commands.renders import RendersOptions


def compare(
    first: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="A")],
    second: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="B")],
    run: Path | None = None,
    capture: Path | None = None,
    protocol: str | None = None,
    views: bool = False,
    csv: Path | None = None,
) -> None:
    """Compare two runs, or two methods of a run, with paired tests.

    Args:
        first: run folder, a method with --run, or renders in any form that `score` accepts with
            --capture.
        second: second run, method or renders; differences are first minus second.
        run: run folder of both methods.
        capture: capture of both renders.
        protocol: protocol of the renders (.toml or packaged name); fitted to the capture by
            default.
        views: also compare each view alone.
        csv: CSV file for all differences, unrounded, per view too.
    """
    from ggvs_eval.reports.tables.compare_runs import write_comparison

    if capture is None:
        print(write_comparison(first, second, run, views, csv))
        return
    with RendersOptions(capture=capture, protocol=protocol, run=run).scored(
        Path(first), Path(second)
    ) as (folder, labels):
        print(write_comparison(labels[0], labels[1], folder.root, views, csv))
