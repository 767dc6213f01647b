"""Where the error of each method varies: over views, over time, or in neither alone."""

from collections.abc import Callable

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Row, Table
from ggvs_eval.statistics.decomposition import TwoWay, decompose_metric

METRIC = "L1"
UNIT = "grey levels of 255"
CAPTION = (
    "L1 of every view and frame taken apart: mean + view effect + time effect + rest; shares of the variance about the mean. "
    "SDT sees time and rest, SDV sees views and rest."
)
COLUMNS: tuple[tuple[Column, str, Callable[[TwoWay], float]], ...] = (
    (Column("mean L1", UNIT, False), "{:.2f}", lambda parts: parts.mean),
    (Column("views", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["view"]),
    (Column("time", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["time"]),
    (Column("rest", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["rest"]),
)


def decomposition_table(run: MeasuredRun) -> Table | None:
    """The table of one run; None where it has a single view or frame, or no L1."""
    if run.protocol.frames.count < 2 or len(run.protocol.views.test) < 2 or METRIC not in set(run.results.table["metric"]):
        return None
    rows = [Row(run.name(label), _cells(run, label), "ours" if label in run.ours else "measured") for label in run.labels]
    columns = tuple(column for column, _, _ in COLUMNS)
    return Table("decomposition", "Where the error varies", CAPTION, columns, tuple(rows), run.scene)


def _cells(run: MeasuredRun, label: str) -> tuple[Cell, ...]:
    method, _, variant = label.partition("+")
    try:
        parts = decompose_metric(run.results, METRIC, run.scene, method, variant, run.protocol.dataset)
    except ResultsError as error:
        return tuple(Cell(f"not computed: {error}") for _ in COLUMNS)
    return tuple(Cell(text.format(value(parts)), value(parts)) for _, text, value in COLUMNS)
