"""A report of one or several runs: the page, the tables in three formats, and the figures."""

import os
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.curves import curve_panels, draw_curves
from ggvs_eval.reports.decomposition_table import decomposition_table
from ggvs_eval.reports.measured import MeasuredRun, read_run
from ggvs_eval.reports.page import RunSection, render_page
from ggvs_eval.reports.published import CAVEATS, SOURCE
from ggvs_eval.reports.slice_figure import draw_slices
from ggvs_eval.reports.slices import all_slices
from ggvs_eval.reports.table import Table
from ggvs_eval.reports.table_formats import to_csv, to_latex, to_markdown
from ggvs_eval.reports.tables import main_tables, view_tables
from ggvs_eval.reports.timing import timing_table
from ggvs_eval.results import merge_results


def write_report(runs: Sequence[Path], out: Path | None = None) -> Path:
    """Write ``index.html``, ``tables.md``, ``tables.csv``, ``tables.tex`` and ``figures/*.png``.

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
    _write_tables(sections, tables, results.provenance["protocol_sha256"], out)
    for index, section in enumerate(sections):
        _draw_figures(section, out / "figures" / (f"run{index}" if len(sections) > 1 else ""))
    return _write_text(out / "index.html", render_page(sections, tables, results.provenance))


def _section(run: MeasuredRun) -> RunSection:
    decomposition = decomposition_table(run)
    by_view = ((decomposition,) if decomposition else ()) + view_tables(run)
    return RunSection(run, by_view, timing_table(run), all_slices(run), curve_panels(run))


def _write_tables(sections: Sequence[RunSection], tables: Sequence[Table], sha256: str, out: Path) -> None:
    """All tables of the page in the three formats."""
    everything = [*tables, *(table for section in sections for table in (*section.view_tables, section.timing))]
    notes = [f"Protocol {sections[0].run.protocol.name}, sha256 {sha256}"]
    if any(row.kind == "published" for table in tables for row in table.rows):
        notes += [f"Grey or italic rows are published values: {SOURCE}", *CAVEATS]
    _write_text(out / "tables.md", to_markdown(everything, notes))
    _write_text(out / "tables.csv", to_csv(everything))
    _write_text(out / "tables.tex", to_latex(everything, notes))


def _draw_figures(section: RunSection, folder: Path) -> None:
    for slices in section.slices:
        draw_slices(slices, folder / ("epi.png" if slices.kind == "epi" else f"x-t_{slices.view}.png"))
    for metric in dict.fromkeys(panel.metric for panel in section.panels):
        draw_curves([panel for panel in section.panels if panel.metric == metric], folder / f"curves_{metric}.png")


def _write_text(path: Path, text: str) -> Path:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)
    return path
