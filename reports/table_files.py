"""All tables of a report as files: Markdown, CSV, LaTeX and a workbook, and the paper's values beside ours."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ggvs_eval.files.atomic import write_text
from ggvs_eval.reports.model.table import Table
from ggvs_eval.reports.run_groups import RunGroup
from ggvs_eval.reports.tables.excel import has_excel, write_excel
from ggvs_eval.reports.tables.paper_layout import paper_tables
from ggvs_eval.reports.tables.published import CAVEATS, SOURCE
from ggvs_eval.reports.tables.reproduction import Reproduction
from ggvs_eval.reports.tables.reproduction_formats import reproduction_csv, reproduction_markdown
from ggvs_eval.reports.tables.table_formats import to_csv, to_latex, to_markdown


def write_tables(groups: Sequence[RunGroup], reproduced: Sequence[Reproduction], out: Path) -> None:
    """Write all tables of the page, and every value that the paper publishes beside ours.

    Of several groups each file holds all: ``tables.csv`` tells them apart by its columns of the protocol, the others by titles.

    Args:
        groups: runs by protocol.
        reproduced: the paper's values beside ours.
        out: folder to write to.
    """
    everything = [table for group in groups for table in _titled(group, len(groups) > 1)]
    notes = _notes(groups)
    values = {
        "values": to_csv([(group.protocol, group.all_tables) for group in groups]),
        "reproduction": reproduction_csv(reproduced),
    }
    write_text(out / "tables.md", to_markdown(everything, notes))
    write_text(out / "tables.csv", values["values"])
    write_text(out / "tables.tex", to_latex(everything, notes))
    write_text(out / "reproduction.md", reproduction_markdown(reproduced))
    write_text(out / "reproduction.csv", values["reproduction"])
    write_text(out / "reproduction.tex", to_latex(paper_tables(reproduced), CAVEATS))
    if has_excel():
        write_excel(everything, values, out / "tables.xlsx")
    else:
        print("tables.xlsx not written: pandas needs openpyxl for it; pip install openpyxl", file=sys.stderr)


def _titled(group: RunGroup, is_one_of_several: bool) -> tuple[Table, ...]:
    """The tables of a group; of one of several, each says which."""
    if not is_one_of_several:
        return group.all_tables
    return tuple(replace(table, dataset=_where(table, group)) for table in group.all_tables)


def _where(table: Table, group: RunGroup) -> str:
    """Data set or scene of a table and its group, the scene once."""
    return group.name if table.dataset == group.scenes else f"{table.dataset}: {group.name}"


def _notes(groups: Sequence[RunGroup]) -> list[str]:
    """What holds for whole files: protocols, and where published values come from."""
    called = [f"{one.protocol.name} ({one.name})" if len(groups) > 1 else one.protocol.name for one in groups]
    notes = [f"Protocol {name}, sha256 {one.protocol.sha256}" for name, one in zip(called, groups, strict=True)]
    if any(row.kind == "published" for group in groups for table in group.tables for row in table.rows):
        notes += [f"Grey or italic rows are published values: {SOURCE}", *CAVEATS]
    return notes
