"""Grey rows that were computed on this capture but belong to no method: noise ceilings, the captured images along a path."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ggvs_eval.reports.model.metric_note import MetricNote
from ggvs_eval.reports.model.table import Cell, Row, format_value
from ggvs_eval.run_folder import RunFolder, read_json

REFERENCES_FILE = "references.json"


@dataclass(frozen=True)
class Reference:
    """One such row.

    Attributes:
        group: table it stands in, e.g. ``consistency``.
        name: what it is.
        note: how it was made, one sentence.
        values: metric -> value, or the reason why there is none.
    """

    group: str
    name: str
    note: str
    values: Mapping[str, float | str]


def read_references(folder: RunFolder) -> tuple[Reference, ...]:
    """What the score step wrote beside the results; nothing where it wrote none."""
    file = folder.root / REFERENCES_FILE
    return tuple(Reference(**entry) for entry in read_json(file)) if file.is_file() else ()


def reference_rows(references: Sequence[Reference], group: str, notes: Sequence[MetricNote]) -> tuple[Row, ...]:
    """The rows of one table; a reference that knows none of its metrics is left out."""
    return tuple(
        Row(reference.name, tuple(_cell(note, reference.values.get(note.name)) for note in notes), "reference")
        for reference in references
        if reference.group == group and any(note.name in reference.values for note in notes)
    )


def _cell(note: MetricNote, value: float | str | None) -> Cell:
    if value is None:
        return Cell("no such reference")
    return Cell(f"not computed: {value}") if isinstance(value, str) else Cell(format_value(value, note.decimals), value)
