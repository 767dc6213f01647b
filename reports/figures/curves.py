"""Error curves along time: one small panel per metric and view, every method in it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from ggvs_eval.reports.figures.axes import (
    COLOURS,
    DASHES,
    Curve,
    Panel,
    method_numbers,
    save_figure,
    with_margin,
)
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.section import Draw, FigurePlaces, Report, SectionContent


def curve_panels(run: MeasuredRun) -> tuple[Panel, ...]:
    """Panels of every metric that has a value per frame, metric by metric, view by view.

    None for a run of one frame.
    """
    return tuple(panel for metric in run.metrics for panel in _metric_panels(run, metric))


def _metric_panels(run: MeasuredRun, metric: str) -> list[Panel]:
    """Return one panel per view, all on the same axes, so that levels can be compared between
    views.
    """
    curves = {view: _curves(run, metric, view) for view in run.protocol.views.test}
    values = [value for view in curves.values() for curve in view for value in curve.values]
    frames = [frame for view in curves.values() for curve in view for frame in curve.frames]
    if not values or min(frames) == max(frames):
        return []
    low, high = with_margin(min(values), max(values))
    note = run.metrics[metric]
    better = "higher is better" if note.higher_is_better else "lower is better"
    bounds = (min(frames), max(frames), low, high)
    return [
        Panel(
            metric=metric,
            unit=note.unit,
            better=better,
            view=view,
            curves=curves[view],
            bounds=bounds,
        )
        for view in curves
    ]


def _curves(run: MeasuredRun, metric: str, view: str) -> tuple[Curve, ...]:
    """Finite values of every method, in the order of the methods."""
    curves = {}
    for label, values in run.per_frame(metric, view).items():
        series = values.replace([math.inf, -math.inf], math.nan).dropna().sort_index()
        curves[label] = Curve(
            run.name(label), tuple(series.index.astype(int)), tuple(map(float, series))
        )
    return tuple(
        curves[label] for label in dict.fromkeys([*run.labels, *curves]) if label in curves
    )


def draw_curves(
    panels: Sequence[Panel], out: Path, numbers: Mapping[str, int] | None = None
) -> Path:
    """Draw the panels of one metric side by side, for print, in the colours of `numbers`, see
    `method_numbers`.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(3.4, 2.6 * len(panels)), 2.6), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    numbers = numbers or method_numbers(curve.name for panel in panels for curve in panel.curves)
    for axis, panel in zip(axes, panels, strict=True):
        for curve in panel.curves:
            dashes = [
                float(length) / 2 for length in DASHES[numbers[curve.name] % len(DASHES)].split()
            ]
            colour = COLOURS[numbers[curve.name] % len(COLOURS)]
            axis.plot(
                curve.frames,
                curve.values,
                color=colour,
                linewidth=1.1,
                label=curve.name,
                dashes=dashes or (None, None),
            )
        axis.set_title(panel.view, fontsize=8)
        axis.set_xlabel("frame", fontsize=7)
        axis.tick_params(labelsize=6)
        axis.grid(alpha=0.25, linewidth=0.5)
    unit = f" ({panels[0].unit})" if panels[0].unit else ""
    axes[0].set_ylabel(f"{panels[0].metric}{unit}, {panels[0].better}", fontsize=7)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=2, fontsize=6, frameon=False)
    return save_figure(figure, out)


def curves_section(report: Report) -> SectionContent:
    """Return the curves of each run, for the page and as figures."""
    panels = {key: curve_panels(run) for key, run in report.runs.items()}
    values = {
        key: {"curves": len(run.frames) > 1, "panels": panels[key]}
        for key, run in report.runs.items()
    }

    def figures(places: FigurePlaces) -> Iterator[Draw]:
        for key, of_run in panels.items():
            for metric in dict.fromkeys(panel.metric for panel in of_run):
                of_metric = [panel for panel in of_run if panel.metric == metric]
                out = places.folders[key] / f"curves_{metric}.png"
                yield partial(draw_curves, of_metric, out, places.numbers)

    return SectionContent(values=values, figures=figures)
