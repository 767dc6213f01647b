"""What is told before runs begin."""

import sys
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.pipelines.planning.run_request import RunRequest


def print_plan(requests: Sequence[RunRequest], jobs: int, folder: Path, dry_run: bool = False) -> None:
    """Tell what stands before some runs, as a few lines; nothing where all is done.

    Args:
        requests: the runs.
        jobs: processes.
        folder: where they go.
        dry_run: nothing will follow: leave no trace, and say so even where all is done.

    Raises:
        ProtocolError: they need more room than the disk has.
    """
    from ggvs_eval.pipelines.planning.plan import plan_runs

    planned = plan_runs(requests, jobs, folder, keep=not dry_run)
    text = planned.describe()
    if text or dry_run:
        print(text or f"{folder}: nothing is left to do", file=sys.stdout if dry_run else sys.stderr)
    planned.require_disk()
