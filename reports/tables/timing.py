"""Time per stage and frame, as the render jobs recorded it."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ggvs_eval.files.images import read_image
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Row, Table
from ggvs_eval.run_folder import JOB_FILE, frame_path, read_json

TOTAL = "total"


def timing_table(run: MeasuredRun) -> Table:
    """Median and 95th percentile of each stage's time in milliseconds, over all views, without each view's first frame.

    Reading:
        The first frame of a view pays for caches and has no history, so it is no steady state; a run of one frame has no other
        and the caption says so.
    """
    jobs = {label: _jobs(run, label) for label in run.labels}
    first = min(1, run.protocol.frames.count - 1)
    times = {label: _stage_seconds(records, first) for label, records in jobs.items()}
    stages = [*dict.fromkeys(stage for stages in times.values() for stage in stages if stage != TOTAL), TOTAL]
    columns = tuple(Column(stage, "ms", False) for stage in stages)
    rows = [
        Row(run.name(label), tuple(_cell(times[label], stage) for stage in stages), "ours" if label in run.ours else "measured")
        for label in run.labels
    ]
    return Table("timing", "Time per frame", _caption(run, jobs, first), columns, tuple(rows), run.scene)


def _jobs(run: MeasuredRun, label: str) -> list[dict[str, Any]]:
    """Records of the render jobs; frames that others rendered have none."""
    files = [run.folder.renders(label, view) / JOB_FILE for view in run.protocol.views.test]
    return [read_json(file) for file in files if file.is_file()]


def _stage_seconds(records: Sequence[dict[str, Any]], first: int) -> dict[str, list[float]]:
    """Seconds of each stage and of their sum, frames `first`.. of all views in one list."""
    stages: dict[str, list[float]] = {}
    for record in records:
        kept = {stage: values[first:] for stage, values in record.get("seconds", {}).items()}
        for stage, values in kept.items():
            stages.setdefault(stage, []).extend(values)
        if kept:
            stages.setdefault(TOTAL, []).extend(map(sum, zip(*kept.values(), strict=True)))
    return stages


def _cell(stages: dict[str, list[float]], stage: str) -> Cell:
    if not stages:
        return Cell("not computed: no times recorded")
    if not stages.get(stage):
        return Cell("no such stage")
    median, p95 = np.percentile(stages[stage], [50, 95]) * 1000
    return Cell(f"{median:.1f} ({p95:.1f})", float(median))


def _caption(run: MeasuredRun, jobs: dict[str, list[dict[str, Any]]], first: int) -> str:
    height, width = read_image(frame_path(run.folder.truth(run.protocol.views.test[0]), run.frames[0])).shape[:2]
    threads = sorted({record["threads"] for records in jobs.values() for record in records if "threads" in record})
    on = f"{' or '.join(map(str, threads))} thread{'' if threads == [1] else 's'}" if threads else "threads not recorded"
    left_out = "each view's first frame left out" if first else "of the only frame of each view"
    size = f"K = {run.protocol.synthesis.k}, {width} × {height}, {on}"
    return f"Median (95th percentile), {left_out}; {size}; reading and writing of files excluded."
