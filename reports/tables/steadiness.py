"""The table of videos that were measured without truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ggvs_eval.files.atomic import write_text
from ggvs_eval.reports.model.measured import MetricNote
from ggvs_eval.reports.model.table import Row, Table, measured_cell, rank
from ggvs_eval.reports.tables.report_tables import metric_column
from ggvs_eval.reports.tables.table_formats import to_csv, to_latex, to_markdown

FORMATS = (".md", ".csv", ".tex")
UNLIKE = "Different number or size of frames: the values are not comparable"


def steadiness_table(
    metrics: Mapping[str, Mapping[str, Any]],
    values: Mapping[str, Mapping[str, float]],
    not_computed: Mapping[str, Mapping[str, str]],
    where: str,
) -> Table:
    """Return one row per video, one column per metric.

    The sharpness follows the first value that blur would improve.

    Args:
        metrics: metric -> its note as JSON values.
        values: video -> metric -> value.
        not_computed: video -> metric -> reason.
        where: which pixels were measured, in words.
    """
    notes = [MetricNote(name, **record) for name, record in metrics.items()]
    columns = tuple(metric_column(note) for note in notes)
    rows = [
        Row(
            name,
            tuple(
                measured_cell(
                    row.get(note.name), not_computed[name].get(note.name, ""), None, note.decimals
                )
                for note in notes
            ),
        )
        for name, row in values.items()
    ]
    caption = (
        f"Mean over the frames, {where}, without reference. Blur is stable too: read each "
        f"value with the sharpness."
    )
    return Table(
        key="steadiness",
        title=notes[0].group_title,
        caption=caption,
        columns=columns,
        rows=rank(columns, rows),
    )


def remarks_on(shapes: Mapping[str, str]) -> list[str]:
    """State number and size of the frames of each video, and whether these are comparable."""
    return [
        *(f"{name}: {shape}" for name, shape in shapes.items()),
        *([UNLIKE] if len(set(shapes.values())) > 1 else []),
    ]


def write_steadiness(out: Path, table: Table, remarks: list[str]) -> None:
    """Write the table in the format that the file's name asks for, one of `FORMATS`."""
    texts = {
        ".md": lambda: to_markdown([table], remarks),
        ".csv": lambda: to_csv([(None, [table])]),
        ".tex": lambda: to_latex([table], remarks),
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, texts[out.suffix]())
