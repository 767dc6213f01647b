"""The table of time per stage and frame, and the paper's times next to those of a run."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from ggvs_eval.files.images import read_image
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import DASH, Cell, Column, Table
from ggvs_eval.reports.section import RUNS_KEPT
from ggvs_eval.run_folder import JOB_FILE, frame_path, read_json

TOTAL = "total"


@lru_cache(maxsize=RUNS_KEPT)
def timing_table(run: MeasuredRun) -> Table:
    """Median and 95th percentile of each stage's time in milliseconds, over all views, without each
    view's first frame.

    Reading:
        The first frame of a view pays for caches and has no history, so it is no steady state; a
        run of one frame has no other and the caption says so.
    """
    jobs = {label: render_records(run, label) for label in run.labels}
    first = min(1, run.protocol.frames.count - 1)
    times = {label: _stage_seconds(records, first) for label, records in jobs.items()}
    stages = [
        *dict.fromkeys(stage for stages in times.values() for stage in stages if stage != TOTAL),
        TOTAL,
    ]
    columns = tuple(Column(stage, "ms", False) for stage in stages)
    rows = [
        run.row(label, [_stage_cell(times[label], stage) for stage in stages])
        for label in run.labels
    ]
    return Table(
        key="timing",
        title="Time per frame",
        caption=_caption(run, jobs, first),
        columns=columns,
        rows=tuple(rows),
        dataset=run.scene,
    )


def render_records(run: MeasuredRun, label: str) -> list[dict[str, Any]]:
    """Records of the render jobs; frames that others rendered have none."""
    files = [run.folder.renders(label, view) / JOB_FILE for view in run.protocol.views.test]
    return [read_json(file) for file in files if file.is_file()]


def _stage_seconds(records: Sequence[dict[str, Any]], first: int) -> dict[str, list[float]]:
    """Return the seconds of each stage and of their sum, frames `first`..

    Of all views in one list.
    """
    stages: dict[str, list[float]] = {}
    for record in records:
        stage_values = {
            stage: values[first:] for stage, values in record.get("seconds", {}).items()
        }
        for stage, values in stage_values.items():
            stages.setdefault(stage, []).extend(values)
        if stage_values:
            stages.setdefault(TOTAL, []).extend(map(sum, zip(*stage_values.values(), strict=True)))
    return stages


def _stage_cell(stages: dict[str, list[float]], stage: str) -> Cell:
    if not stages:
        return Cell(DASH, note="no times recorded")
    if not stages.get(stage):
        return Cell(DASH, note="no such stage")
    median, p95 = np.percentile(stages[stage], [50, 95]) * 1000
    return Cell(f"{median:.1f}", float(median), beside=f"({p95:.1f})")


def _caption(run: MeasuredRun, jobs: dict[str, list[dict[str, Any]]], first: int) -> str:
    if not any(jobs.values()):
        return "No times: others rendered these frames."
    height, width = read_image(
        frame_path(run.folder.truth(run.protocol.views.test[0]), run.frames[0])
    ).shape[:2]
    threads = sorted(
        {
            record["threads"]
            for records in jobs.values()
            for record in records
            if "threads" in record
        }
    )
    on = (
        f"{' or '.join(map(str, threads))} thread{'' if threads == [1] else 's'}"
        if threads
        else "threads not recorded"
    )
    left_out = "each view's first frame left out" if first else "of the only frame of each view"
    size = ", ".join(filter(None, (run.sources_text, f"{width} × {height}", on)))
    return f"Median (95th percentile), {left_out}; {size}; reading and writing of files excluded."


TIMINGS = {  # of the paper -> the stage here that does what its time is of
    "forward_splatting_ms": "splat",
    "tsdf_ms": "tsdf",
    "blending_tensorrt_ms": None,
    "blending_no_tensorrt_ms": "blend",
    "total_no_tensorrt_ms_text": TOTAL,
    "total_ms_text": TOTAL,
}


def evaluate_time(
    runs: Sequence[MeasuredRun], label: str, key: str, paper_ms: float
) -> tuple[Cell | None, str]:
    """Return the time of a stage here and what it is against the paper's, or None and why there is
    none.

    Reading:
        A time belongs to its machine: the paper's is a GPU that it does not name, this one is the
        machine of the run. So it is set next to the paper's with the ratio of the two, and never
        called reproduced.
    """
    stage = TIMINGS[key]
    if stage is None:
        return None, "this package does not use TensorRT"
    times_ms = [value for run in runs if (value := _stage_ms(run, label, stage)) is not None]
    if not times_ms:
        return None, f"no time of stage {stage} recorded"
    value = float(np.mean(times_ms))
    ratio = f"{value / paper_ms:.2g} times the paper's" if paper_ms else "the paper has 0"
    return Cell(
        f"{value:.1f}", value
    ), f"{ratio}; median of a frame on the machine of this run, the paper's on an unnamed GPU"


def _stage_ms(run: MeasuredRun, label: str, stage: str) -> float | None:
    """Return the median milliseconds of a stage of one method; None if none were recorded."""
    table = timing_table(run)
    column = next((at for at, column in enumerate(table.columns) if column.name == stage), None)
    return (
        None
        if column is None or label not in run.labels
        else table.rows[run.labels.index(label)].cells[column].value
    )
