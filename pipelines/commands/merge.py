"""The verb of the command line that makes one run of several."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.errors import ResultsError
from ggvs_eval.pipelines.commands.captures import ONE_PER_CORE, Jobs, Output
from ggvs_eval.run_folder import RunFolder


def merge(
    out: Output,
    runs: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN RUN [RUN ...]", help_behavior_hint="(at least two)")
    ],
    copy: bool = False,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Put run folders of one capture and protocol, made on several machines, into a new one, and make its table.

    The runs may differ in their methods and in the views that were rendered; what two of them both have must be the same.

    Args:
        out: output run folder; written atomically.
        runs: run folders; they stay as they are.
        copy: copy files; otherwise they are linked where the file system can.
        jobs: processes that measure what no run has measured.
    """
    from ggvs_eval.pipelines.run.score import score
    from ggvs_eval.pipelines.sweep.merging.merge import merge_runs

    if len(runs) < 2:
        raise ResultsError(f"wanted at least two run folders to merge into {out}, got {len(runs)}; copy a single one")

    def finish(merged: RunFolder) -> None:
        missing = missing_renders(merged)
        if missing:
            print(f"{out}: no table yet, {missing}; merge the runs that have them, or render them here", file=sys.stderr)
        else:
            print(score(merged, jobs).summary().droplevel("dataset").round(4).to_string())

    print(merge_runs(out, runs, copy, finish).root)


def missing_renders(run: RunFolder) -> str:
    """Views that methods of a merged run lack, as text; empty where nothing is missing."""
    from ggvs_eval.coverage import read_import

    views = run.protocol().views.test
    own = [label for label in run.labels() if read_import(run, label) is None]
    lacking = {label: [view for view in views if not run.renders(label, view).is_dir()] for label in own}
    return "; ".join(f"{label} lacks {', '.join(some)}" for label, some in lacking.items() if some)
