"""A report of one or several runs: the page, the tables in three formats, and the figures."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.crop_figure import draw_crops, draw_failures
from ggvs_eval.reports.curves import curve_panels, draw_curves
from ggvs_eval.reports.decomposition_table import decomposition_table
from ggvs_eval.reports.excel import has_excel, write_excel
from ggvs_eval.reports.figures import first_choice
from ggvs_eval.reports.measured import MeasuredRun, read_run
from ggvs_eval.reports.page import RunSection, render_page
from ggvs_eval.reports.paper_layout import paper_tables
from ggvs_eval.reports.published import CAVEATS, SOURCE
from ggvs_eval.reports.reproduction import Reproduction, reproduce
from ggvs_eval.reports.reproduction_formats import reproduction_csv, reproduction_markdown
from ggvs_eval.reports.slice_figure import draw_slices
from ggvs_eval.reports.slices import all_slices
from ggvs_eval.reports.table import Table
from ggvs_eval.reports.table_formats import to_csv, to_latex, to_markdown
from ggvs_eval.reports.tables import main_tables, view_tables
from ggvs_eval.reports.timing import timing_table
from ggvs_eval.results import merge_results


def write_report(runs: Sequence[Path], out: Path | None = None) -> Path:
    """Write ``index.html``, ``tables.*``, ``reproduction.*`` (the paper's values beside ours) and ``figures/*.png``.

    Args:
        runs: run folders, rendered and scored under one protocol.
        out: folder to write to; None takes ``report`` in the first run.

    Returns:
        The page.

    Raises:
        ResultsError: no run, a folder that is not a scored run, or runs of different protocols.
        RenderError: frames are missing.
    """
    if not runs:
        raise ResultsError("wanted at least one run folder, got none; make one with `ggvs-eval run`")
    measured = [read_run(run) for run in runs]
    results = merge_results([run.results for run in measured])
    out = measured[0].folder.report if out is None else out
    sections = [_section(run) for run in measured]
    tables = main_tables(measured, results)
    reproduced = reproduce(measured)
    _write_tables(sections, tables, reproduced, results.provenance["protocol_sha256"], out)
    for index, section in enumerate(sections):
        _draw_figures(section, out / "figures" / (f"run{index}" if len(sections) > 1 else ""))
    return _write_text(out / "index.html", render_page(sections, tables, results.provenance, reproduced))


def _section(run: MeasuredRun) -> RunSection:
    decomposition = decomposition_table(run)
    by_view = ((decomposition,) if decomposition else ()) + view_tables(run)
    return RunSection(run, by_view, timing_table(run), all_slices(run), curve_panels(run))


def _write_tables(
    sections: Sequence[RunSection], tables: Sequence[Table], reproduced: Sequence[Reproduction], sha256: str, out: Path
) -> None:
    """All tables of the page in four formats, and every value that the paper publishes beside ours."""
    everything = [*tables, *(table for section in sections for table in (*section.view_tables, section.timing))]
    notes = [f"Protocol {sections[0].run.protocol.name}, sha256 {sha256}"]
    if any(row.kind == "published" for table in tables for row in table.rows):
        notes += [f"Grey or italic rows are published values: {SOURCE}", *CAVEATS]
    values = {"values": to_csv(everything), "reproduction": reproduction_csv(reproduced)}
    _write_text(out / "tables.md", to_markdown(everything, notes))
    _write_text(out / "tables.csv", values["values"])
    _write_text(out / "tables.tex", to_latex(everything, notes))
    _write_text(out / "reproduction.md", reproduction_markdown(reproduced))
    _write_text(out / "reproduction.csv", values["reproduction"])
    _write_text(out / "reproduction.tex", to_latex(paper_tables(reproduced), CAVEATS))
    if has_excel():
        write_excel(everything, values, out / "tables.xlsx")
    else:
        print("tables.xlsx not written: pandas needs openpyxl for it; pip install openpyxl", file=sys.stderr)


def _draw_figures(section: RunSection, folder: Path) -> None:
    for slices in section.slices:
        draw_slices(slices, folder / ("epi.png" if slices.kind == "epi" else f"x-t_{slices.view}.png"))
    if section.run.pictured:
        label = first_choice(section.run)
        draw_crops(section.run, [folder / "crops.png"], "different" if len(section.run.pictured) > 1 else "worst", label)
        draw_failures(section.run, [folder / "failures.png"], label)
    for metric in dict.fromkeys(panel.metric for panel in section.panels):
        draw_curves([panel for panel in section.panels if panel.metric == metric], folder / f"curves_{metric}.png")


def _write_text(path: Path, text: str) -> Path:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)
    return path
