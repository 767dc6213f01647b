"""The times that the paper reports, and which of our stages stands against each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell
from ggvs_eval.reports.tables.timing import TOTAL, timing_table


@dataclass(frozen=True)
class PublishedTime:
    """The stage here that does what one of the paper's times is of; None where there is none, with the reason."""

    stage: str | None
    why_not: str = ""


TIMINGS = {
    "forward_splatting_ms": PublishedTime("splat"),
    "tsdf_ms": PublishedTime("tsdf"),
    "blending_tensorrt_ms": PublishedTime(None, "this package does not use TensorRT"),
    "blending_no_tensorrt_ms": PublishedTime("blend"),
    "total_no_tensorrt_ms_text": PublishedTime(TOTAL),
    "total_ms_text": PublishedTime(TOTAL),
}


def evaluate_time(runs: Sequence[MeasuredRun], label: str, key: str, paper_ms: float) -> tuple[Cell | None, str]:
    """The time of a stage here and what it is against the paper's, or None and why there is none.

    Reading:
        A time belongs to its machine: the paper's is a GPU that it does not name, ours is the machine of the run. So it is set
        beside the paper's with the ratio of the two, and never called reproduced.
    """
    timing = TIMINGS[key]
    if timing.stage is None:
        return None, timing.why_not
    found = [value for run in runs if (value := _stage_ms(run, label, timing.stage)) is not None]
    if not found:
        return None, f"no time of stage {timing.stage} recorded"
    value = float(np.mean(found))
    ratio = f"{value / paper_ms:.2g} times the paper's" if paper_ms else "the paper has 0"
    return Cell(
        f"{value:.1f}", value
    ), f"{ratio}; median of a frame on the machine of this run, the paper's on a GPU it does not name"


def _stage_ms(run: MeasuredRun, label: str, stage: str) -> float | None:
    """Median milliseconds of a stage of one method; None where none were recorded."""
    table = timing_table(run)
    column = next((at for at, column in enumerate(table.columns) if column.name == stage), None)
    row = next((row for row in table.rows if row.name == run.name(label)), None)
    return None if column is None or row is None else row.cells[column].value
