"""Table of what differs between methods by design, beside what the protocol makes the same for all of them."""

from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.model.measured import METHODS_FILE, MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Table
from ggvs_eval.run_folder import read_json

COLUMNS = (
    Column("depth", describe="whether the method is given depth of its sources"),
    Column("learned from", describe="what its weights or its scene were learned from"),
    Column("not as published", describe="what the implementation does not do as the authors of the method"),
)
UNKNOWN = "unknown: others made it"


def differences_table(run: MeasuredRun) -> Table | None:
    """What a reader weighs himself, as no protocol can remove it; None for runs that were scored before it was recorded."""
    declared = read_json(run.folder.root / METHODS_FILE).get("declared")
    if declared is None:
        return None
    rows = [
        run.row(label, [Cell(declared.get(label, {}).get(column.name, UNKNOWN)) for column in COLUMNS]) for label in run.labels
    ]
    caption = f"What no protocol can make alike. The same for all: {_same(run.protocol)}."
    return Table("differences", "What differs between the methods", caption, COLUMNS, tuple(rows), run.scene)


def _same(protocol: Protocol) -> str:
    synthesis = protocol.synthesis
    size = f"{synthesis.width} x {synthesis.height}" if synthesis.width else "the capture's size"
    return (
        f"test views {', '.join(protocol.views.test)}, each left out of its own rendering and of the depth for it; "
        f"{protocol.frames.count} frames of {size}, resized by {synthesis.resize_filter}; K = {synthesis.k} sources for methods "
        "that render from sources; scores from 8-bit pictures on disk by one implementation of each metric"
    )
