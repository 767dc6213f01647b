"""What reaches the screen of a live viewer: scores of the displayed frames, and their delay."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from ggvs_eval.merged_results import merge_results
from ggvs_eval.reports.figures.stream import draw_rates, rate_panels, stream_table
from ggvs_eval.reports.model.table import Table
from ggvs_eval.reports.section import Draw, FigurePlaces, Report, RunGroup, SectionContent
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.results import without_labels
from ggvs_eval.run_folder import ON_SCREEN

SCORES_KEY, SCORES_TITLE = "stream", "Displayed frames during live capture"


def stream_section(report: Report) -> SectionContent:
    """Return the table and the drawing of each run, and of a group the scores of the displayed
    frames.
    """
    tables = {key: stream_table(run) for key, run in report.runs.items()}
    panels = {key: rate_panels([run]) for key, run in report.runs.items()}
    values: dict[str, dict[str, Any]] = {
        key: {"on_time": tables[key], "rate_panels": panels[key]} for key in report.runs
    }
    scores = {group.id: _displayed_tables(group) for group in report.groups}
    values |= {key: {"elsewhere": (SCORES_KEY,)} for key, of_group in scores.items() if of_group}

    def figures(places: FigurePlaces) -> Iterator[Draw]:
        for key, of_run in panels.items():
            if of_run:
                yield partial(
                    draw_rates, of_run, places.folders[key] / "stream.png", places.numbers
                )

    return SectionContent(
        tables=scores | {key: [table] for key, table in tables.items() if table},
        values=values,
        names=[
            family.name
            for of_run in panels.values()
            for panel in of_run
            for family in panel.families
        ],
        figures=figures,
    )


def _displayed_tables(group: RunGroup) -> list[Table]:
    """Return the scores of what a viewer saw of each method, ranked among each other."""
    runs = []
    for run in group.runs.values():
        results = run.all_results or run.results
        screens = {f"{label}{ON_SCREEN}" for label in run.labels}
        results = without_labels(results, {*results.row_labels} - screens)
        if labels := tuple(dict.fromkeys(results.row_labels)):
            runs.append(replace(run, results=results, labels=labels))
    if not runs:
        return []
    results = merge_results([run.results for run in runs])
    measured_names = {*results.table["metric"]}
    metrics = [name for name in runs[0].metrics if name in measured_names]
    tables = main_tables(runs, results, metrics, with_grey=False)
    return [replace(table, key=SCORES_KEY, title=SCORES_TITLE) for table in tables]
