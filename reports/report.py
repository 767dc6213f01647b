"""A report of one or several runs: the page, the tables in four formats, and the figures."""

import operator
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ggvs_eval.files.atomic import write_text
from ggvs_eval.jobs.engine import run_all
from ggvs_eval.reports.model.measured import is_sweep, sweep_runs
from ggvs_eval.reports.model.table import Table
from ggvs_eval.reports.page.page import page_numbers, render_page
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Draw, FigurePlaces, Report, RunGroup, with_sections
from ggvs_eval.reports.tables.report_tables import main_tables, view_tables
from ggvs_eval.reports.tables.table_formats import (
    has_excel,
    to_csv,
    to_latex,
    to_markdown,
    write_excel,
)
from ggvs_eval.run_folder import RunFolder


def write_tables(report: Report, out: Path, columns: Sequence[str] = ()) -> None:
    """Write all tables of the page, and the files that its sections add.

    Of several groups each file holds all: ``tables.csv`` distinguishes them by its columns of the
    protocol, the others by titles.

    Args:
        columns: metrics of the tables in Markdown, LaTeX and Excel, which are one per data set
            then; all of them by default.

    Raises:
        ResultsError: no such column.
    """
    tables = {group.id: all_tables(report, group) for group in report.groups}
    several = len(report.groups) > 1
    titled: list[Table] = []
    for group in report.groups:
        of_runs = [*group.runs.values()]
        of_group = main_tables(of_runs, group.results, columns) if columns else tables[group.id]
        titled += _titled(group, of_group) if several else of_group
    files = {name: text for content in report.contents for name, text in content.files.items()}
    notes = _notes(report)
    csv = to_csv([(group.protocol, tables[group.id]) for group in report.groups])
    write_text(out / "tables.md", to_markdown(titled, notes))
    write_text(out / "tables.csv", csv)
    write_text(out / "tables.tex", to_latex(titled, notes))
    for name, text in files.items():
        write_text(out / name, text)
    if has_excel():
        values = {Path(name).stem: text for name, text in files.items() if name.endswith(".csv")}
        write_excel(titled, {"values": csv, **values}, out / "tables.xlsx")
    else:
        print(
            "tables.xlsx not written: pandas needs openpyxl for it; pip install openpyxl",
            file=sys.stderr,
        )


def all_tables(report: Report, group: RunGroup) -> list[Table]:
    """Return the tables over all runs of a group, then each run's, in the order of the page."""
    tables = [*group.tables, *report.tables(group.id)]
    for key, run in group.runs.items():
        tables += [
            *report.tables(key, ""),
            *report.tables(key, "views"),
            *view_tables(run),
            *report.tables(key, "timing"),
        ]
    return tables


def _titled(group: RunGroup, tables: Sequence[Table]) -> list[Table]:
    """Name the group where the tables of several are in one file."""
    places = [
        group.name if table.dataset == group.scenes else f"{table.dataset}: {group.name}"
        for table in tables
    ]
    return [replace(table, dataset=place) for table, place in zip(tables, places, strict=True)]


def _notes(report: Report) -> list[str]:
    """Write the notes that hold for whole files: protocols, and what sections add."""
    notes = []
    for group in report.groups:
        name = group.protocol.name
        called = f"{name} ({group.name})" if len(report.groups) > 1 else name
        notes.append(f"Protocol {called}, sha256 {group.protocol.sha256}")
    return notes + [note for content in report.contents for note in content.notes]


def write_report(
    runs: Sequence[Path],
    out: Path | None = None,
    tables_of: Sequence[Path] = (),
    with_figures: bool = True,
    standalone: bool = False,
    columns: Sequence[str] = (),
    jobs: int = 1,
) -> Path:
    """Write ``index.html``, ``tables.*``, files of sections and ``figures/*.png``.

    Runs of one protocol share their tables, as scenes of one data set; runs of another protocol are
    a separate group, on the same page and in the same files.

    Args:
        runs: run folders, rendered and scored, of one protocol or of several; the folder of a sweep
            represents its runs, and its table and curves over K come first.
        out: folder to write to; None takes ``report`` in the first of them.
        tables_of: folders of sweeps that are shown by their tables and curves alone, without their
            runs.
        with_figures: also the figures, which the page does without; a page that is going to grow
            does not need them yet.
        standalone: make a page that loads nothing, also no frames at full size from its run folder.
        columns: metrics of the tables for papers, see `write_tables`.
        jobs: processes that draw the figures.

    Raises:
        ResultsError: no run, a run given twice, or a folder that is not a scored run.
        RenderError: frames are missing.
    """
    roots = [Path(root) for root in runs]
    sweeps = tuple(root for root in roots if is_sweep(root))
    run_roots = [run for root in roots for run in (sweep_runs(root) if root in sweeps else [root])]
    groups = read_groups(run_roots)
    out = RunFolder(roots[0]).report if out is None else out
    folder = None if standalone else out
    report = Report(groups, sweeps=sweeps, tables_of=tuple(map(Path, tables_of)), folder=folder)
    report = with_sections(report)
    write_tables(report, out, columns)
    page = out / "index.html"
    write_text(page, render_page(report))
    if with_figures:
        run_all(operator.call, _figures(report, out / "figures"), jobs, "drawing figures")
    return page


def _figures(report: Report, out: Path) -> list[Draw]:
    """Return what draws each figure; of several runs each has a folder."""
    runs = report.runs
    folders = {"": out} | {key: out / key if len(runs) > 1 else out for key in runs}
    places = FigurePlaces(folders, page_numbers(report))
    figures: list[Draw] = []
    for content in report.contents:
        if content.figures:
            figures += content.figures(places)
    return figures
