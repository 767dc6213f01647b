"""A sweep in a report: its table, and quality and time over the number of source views K."""

import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.figures.axes import Curve, Panel, with_margin
from ggvs_eval.reports.figures.stream import RatePanel, draw_rates, rate_panels
from ggvs_eval.reports.figures.sweep_figures import SECONDS, USUAL, draw_k, read_k_table
from ggvs_eval.reports.model.measured import SWEEP_FILE, MetricNote, read_scores, sweep_runs
from ggvs_eval.reports.model.table import Cell, Column, Row, Table, format_value
from ggvs_eval.reports.section import Draw, FigurePlaces, Report, SectionContent
from ggvs_eval.run_folder import RunFolder

CAPTION = (
    "Table of `ggvs-eval sweep`. Each variant is a separate protocol, so nothing is ranked here"
)
RUNS_FOLLOW = "; intervals are in the tables of the single runs below."
RUNS_ELSEWHERE = "; intervals and pictures of the single runs: `ggvs-eval report {}`."


@dataclass(frozen=True)
class SweepSection:
    """Section of the page about one sweep.

    Attributes:
        table: a row per method and variant.
        panels: a curve per method over K; none if the sweep has a single K.
        ks: numbers of source views, ascending.
        measured_on: protocol, frames and views of the curves.
        runs_follow: whether the page shows its runs too.
        rates: quality on the screen over pictures per second, of all its runs; none if nothing is
            on a screen.
    """

    name: str
    table: Table
    panels: tuple[Panel, ...]
    ks: tuple[int, ...]
    measured_on: str
    runs_follow: bool
    rates: tuple[RatePanel, ...] = ()

    @property
    def title(self) -> str:
        """Heading of the section."""
        return (
            "On the screen" if self.rates else "Quality and time over K" if self.panels else "Sweep"
        )


def sweep_section(
    sweep: Path, notes: Mapping[str, MetricNote], runs_follow: bool = True
) -> SweepSection:
    """Read the table of a sweep.

    Args:
        sweep: folder that ``ggvs-eval sweep`` has made.
        notes: metric -> unit and direction, of the sweep's runs.
    """
    caption = CAPTION + (
        RUNS_FOLLOW if runs_follow else RUNS_ELSEWHERE.format(shlex.quote(str(sweep)))
    )
    table = _table(sweep, notes, caption)
    streamed = [run for run in sweep_runs(sweep) if RunFolder(run).stream_record.is_file()]
    is_one_capture = len({run.parent for run in streamed}) == 1
    rates = rate_panels([read_scores(run) for run in streamed]) if is_one_capture else ()
    try:
        over_k = read_k_table(sweep)
    except ResultsError:  # a sweep over other things than K
        return SweepSection(
            name=sweep.name,
            table=table,
            panels=(),
            ks=(),
            measured_on=_measured_on(sweep) if rates else "",
            runs_follow=runs_follow,
            rates=rates,
        )
    metrics = [metric for metric in (*USUAL, SECONDS) if metric in over_k]
    ks = tuple(sorted({int(k) for k in over_k.index.get_level_values("K")}))
    panels = tuple(_panel(over_k, metric, notes) for metric in metrics)
    return SweepSection(
        name=sweep.name,
        table=table,
        panels=panels,
        ks=ks,
        measured_on=_measured_on(sweep),
        runs_follow=runs_follow,
        rates=rates,
    )


def _measured_on(sweep: Path) -> str:
    """Protocol, frames and views of its runs; those of one capture differ in K alone."""
    protocols = [RunFolder(run).protocol() for run in sweep_runs(sweep)]
    kinds = dict.fromkeys(
        (protocol.name, protocol.frames.count, ", ".join(protocol.views.test))
        for protocol in protocols
    )
    return "; ".join(f"protocol {name}: {count} frames of {views}" for name, count, views in kinds)


def _table(sweep: Path, notes: Mapping[str, MetricNote], caption: str) -> Table:
    lines = pd.read_csv(sweep / SWEEP_FILE).fillna({"capture": ""})
    levels = [name for name in ("method", "variant", "capture") if name in lines]
    metrics = [name for name in lines.columns if name not in levels]
    columns = tuple(_column(metric, notes) for metric in metrics)
    rows = [
        Row(
            ", ".join(
                re.sub(r"^k(\d+)$", r"K = \1", str(line[level]))
                for level in levels
                if line[level] != ""
            ),
            tuple(_cell(line[metric], notes.get(metric)) for metric in metrics),
        )
        for _, line in lines.iterrows()
    ]
    return Table(
        key="sweep",
        title=f"Sweep {sweep.name}",
        caption=caption,
        columns=columns,
        rows=tuple(rows),
        dataset=sweep.name,
    )


def _column(metric: str, notes: Mapping[str, MetricNote]) -> Column:
    if metric == SECONDS:
        return Column(
            name=metric,
            unit="s",
            higher_is_better=False,
            describe="Median time of a frame over all views.",
        )
    note = notes.get(metric)
    return (
        Column(metric)
        if note is None
        else Column(
            name=metric,
            unit=note.unit,
            higher_is_better=note.higher_is_better,
            describe=note.describe,
        )
    )


def _cell(value: float, note: MetricNote | None) -> Cell:
    if pd.isna(value):
        return Cell("not measured")
    return Cell(format_value(float(value), note.decimals if note else None), float(value))


def _panel(over_k: pd.DataFrame, metric: str, notes: Mapping[str, MetricNote]) -> Panel:
    """Return one metric over K, a curve per method; time begins at 0."""
    column = _column(metric, notes)
    curves = []
    for method in dict.fromkeys(over_k.index.get_level_values("method")):
        values = over_k.loc[method, metric].dropna()
        curves.append(Curve(str(method), tuple(map(int, values.index)), tuple(map(float, values))))
    every = [value for curve in curves for value in curve.values]
    low, high = with_margin(min(every, default=0.0), max(every, default=1.0))
    ks = over_k.index.get_level_values("K")
    bounds = (int(min(ks)), int(max(ks)), 0.0 if metric == SECONDS else low, high)
    better = "higher is better" if column.higher_is_better else "lower is better"
    return Panel(
        metric=metric, unit=column.unit, better=better, view="", curves=tuple(curves), bounds=bounds
    )


def sweeps_section(report: Report) -> SectionContent:
    """Return a sheet for each sweep, and its figures."""
    folders = (*report.sweeps, *report.tables_of)
    notes = next(iter(report.runs.values())).metrics
    swept = [
        sweep_section(folder, notes, runs_follow=folder in report.sweeps) for folder in folders
    ]
    sheets = []
    names = []
    for at, sweep in enumerate(swept):
        place = {
            "id": f"sweep{at}",
            "title": sweep.title,
            "comes_first": sweep.runs_follow,
            "template": "sweep",
        }
        sheets.append(place | vars(sweep))
        names += [curve.name for panel in sweep.panels for curve in panel.curves]
        names += [family.name for panel in sweep.rates for family in panel.families]

    def figures(places: FigurePlaces) -> Iterator[Draw]:
        for at, (folder, sweep) in enumerate(zip(folders, swept, strict=True)):
            if sweep.panels:
                yield partial(
                    draw_k, folder, places.folders[""] / f"k{at or ''}.png", numbers=places.numbers
                )
            if sweep.rates:
                yield partial(
                    draw_rates,
                    sweep.rates,
                    places.folders[""] / f"stream{at or ''}.png",
                    places.numbers,
                )

    return SectionContent(sheets=sheets, names=names, figures=figures)
