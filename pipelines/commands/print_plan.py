"""The plan of runs, printed before they begin."""

import sys
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.pipelines.run.run_plan import RunPlan


def print_plan(plans: Sequence[RunPlan], jobs: int, folder: Path, dry_run: bool = False) -> None:
    """Tell what runs will do, as a few lines; nothing where all is done.

    Args:
        plans: of the runs.
        jobs: processes.
        folder: where they go.
        dry_run: nothing will follow: say so even where all is done.

    Raises:
        ProtocolError: they need more room than the disk has.
    """
    from ggvs_eval.pipelines.run.work_left import count_work
    from ggvs_eval.pipelines.sweep.demo_plan import renders_first

    if not plans:
        return
    work = count_work(plans, folder, jobs)
    notes = [note for plan in plans for note in plan.capture.notes if note not in plan.request.capture.notes]
    lines = [*dict.fromkeys(notes), *renders_first(plan.request.capture for plan in plans), *work.describe().splitlines()]
    if lines or dry_run:
        print("\n".join(lines) or f"{folder}: nothing is left to do", file=sys.stdout if dry_run else sys.stderr)
    work.require_disk()
