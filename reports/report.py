"""A report of one or several runs: the page, the tables in four formats, and the figures."""

import operator
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from ggvs_eval.files.atomic import write_text
from ggvs_eval.jobs.engine import run_all
from ggvs_eval.reports.figures.curves import draw_curves
from ggvs_eval.reports.figures.paper_figures import draw_crops, draw_failures
from ggvs_eval.reports.figures.regions import RULES, Rule, find_regions
from ggvs_eval.reports.figures.slices import draw_slices
from ggvs_eval.reports.figures.sweep_figures import draw_k, draw_rates
from ggvs_eval.reports.model.table import Table
from ggvs_eval.reports.page.page import page_numbers, render_page
from ggvs_eval.reports.page.sweep_section import is_sweep, sweep_runs, sweep_section
from ggvs_eval.reports.run_groups import RunGroup, RunSection, read_groups
from ggvs_eval.reports.tables.published import CAVEATS, PAPER, SOURCE
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.reproduction import Reproduction, paper_tables, reproduce, reproduction_csv, reproduction_markdown
from ggvs_eval.reports.tables.table_formats import has_excel, to_csv, to_latex, to_markdown, write_excel
from ggvs_eval.run_folder import RunFolder


def write_tables(groups: Sequence[RunGroup], reproduced: Sequence[Reproduction], out: Path, columns: Sequence[str] = ()) -> None:
    """Write all tables of the page, and every value of the paper next to this run's.

    Of several groups each file holds all: ``tables.csv`` distinguishes them by its columns of the protocol, the others by titles.

    Args:
        columns: metrics of the tables in Markdown, LaTeX and Excel, which are one per data set then; all of them by default.

    Raises:
        ResultsError: no such column.
    """
    everything = [table for group in groups for table in _titled(group, len(groups) > 1, columns)]
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


def _titled(group: RunGroup, is_one_of_several: bool, columns: Sequence[str]) -> tuple[Table, ...]:
    runs = [section.run for section in group.sections]
    tables = main_tables(runs, group.results, columns) if columns else group.all_tables
    if not is_one_of_several:
        return tables
    places = [group.name if table.dataset == group.scenes else f"{table.dataset}: {group.name}" for table in tables]
    return tuple(replace(table, dataset=place) for table, place in zip(tables, places, strict=True))


def _notes(groups: Sequence[RunGroup]) -> list[str]:
    """Write the notes that hold for whole files: protocols, and the source of published values."""
    called = [f"{one.protocol.name} ({one.name})" if len(groups) > 1 else one.protocol.name for one in groups]
    notes = [f"Protocol {name}, sha256 {one.protocol.sha256}" for name, one in zip(called, groups, strict=True)]
    if any(row.name.endswith(PAPER) for group in groups for table in group.tables for row in table.rows):
        notes += [f"Grey or italic rows are published values: {SOURCE}", *CAVEATS]
    return notes


def write_report(
    runs: Sequence[Path],
    out: Path | None = None,
    tables_of: Sequence[Path] = (),
    with_figures: bool = True,
    standalone: bool = False,
    columns: Sequence[str] = (),
    jobs: int = 1,
) -> Path:
    """Write ``index.html``, ``tables.*``, ``reproduction.*`` (the paper's values next to the run's) and ``figures/*.png``.

    Runs of one protocol share their tables, as scenes of one data set; runs of another protocol are a separate group,
    on the same page and in the same files.

    Args:
        runs: run folders, rendered and scored, of one protocol or of several; the folder of a sweep represents its runs, and its
            table and curves over K come first.
        out: folder to write to; None takes ``report`` in the first of them.
        tables_of: folders of sweeps that are shown by their tables and curves alone, without their runs.
        with_figures: also the figures, which the page does without; a page that is going to grow does not need them yet.
        standalone: make a page that loads nothing, also no frames at full size from its run folder.
        columns: metrics of the tables for papers, see `write_tables`.
        jobs: processes that draw the figures.

    Raises:
        ResultsError: no run, a run given twice, or a folder that is not a scored run.
        RenderError: frames are missing.
    """
    roots = [Path(root) for root in runs]
    sweeps = [root for root in roots if is_sweep(root)]
    groups = read_groups([run for root in roots for run in (sweep_runs(root) if is_sweep(root) else [root])])
    sections = [section for group in groups for section in group.sections]
    out = RunFolder(roots[0]).report if out is None else out
    reproduced = reproduce([section.run for section in sections])
    write_tables(groups, reproduced, out, columns)
    swept = [sweep_section(sweep, sections[0].run.metrics, runs_follow=sweep in sweeps) for sweep in (*sweeps, *tables_of)]
    page = out / "index.html"
    write_text(page, render_page(groups, reproduced, swept, None if standalone else out))
    numbers = page_numbers(groups, swept)
    if with_figures:
        figures: list[Callable[[], object]] = []
        for index, section in enumerate(sections):
            figures += _figures(section, out / "figures" / (f"run{index}" if len(sections) > 1 else ""), numbers)
        for index, sweep in enumerate((*sweeps, *tables_of)):
            if swept[index].panels:
                figures.append(partial(draw_k, sweep, out / "figures" / f"k{index or ''}.png", numbers=numbers))
            if swept[index].rates:
                figures.append(partial(draw_rates, swept[index].rates, out / "figures" / f"stream{index or ''}.png", numbers))
        run_all(operator.call, figures, jobs, "drawing figures")
    return page


def _figures(section: RunSection, folder: Path, numbers: Mapping[str, int]) -> Iterator[Callable[[], object]]:
    """Yield what draws each figure of a run."""
    for slices in section.slices:
        yield partial(draw_slices, slices, folder / ("epi.png" if slices.kind == "epi" else f"x-t_{slices.view}.png"))
    if section.run.pictured:
        label = section.run.ours_first[0]
        rule: Rule = "different" if len(section.run.pictured) > 1 else "worst"
        regions = find_regions(section.run, rule, label, 2)
        yield partial(draw_crops, section.run, [folder / "crops.png"], regions, RULES[rule].format(name=section.run.name(label)))
        yield partial(draw_failures, section.run, [folder / "failures.png"], label)
    if section.rate_panels:
        yield partial(draw_rates, section.rate_panels, folder / "stream.png", numbers)
    for metric in dict.fromkeys(panel.metric for panel in section.panels):
        panels = [panel for panel in section.panels if panel.metric == metric]
        yield partial(draw_curves, panels, folder / f"curves_{metric}.png", numbers)
