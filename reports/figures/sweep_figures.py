"""Figures of sweeps: quality and time over the number of source views K, and quality on the screen over pictures per second."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from ggvs_eval.errors import ResultsError
from ggvs_eval.merged_results import merge_results
from ggvs_eval.protocol import ON_SCREEN
from ggvs_eval.reports.figures.curves import COLOURS, Panel, method_numbers, save_figure, with_margin
from ggvs_eval.reports.figures.look import USUAL, FigureLook
from ggvs_eval.reports.model.measured import MeasuredRun, read_scores
from ggvs_eval.results import label_of
from ggvs_eval.run_folder import RunFolder, read_json
from ggvs_eval.statistics.intervals import intervals

SWEEP_FILE = "sweep.csv"
SECONDS = "s/frame"
MEAN = "mean"  # what the table of a sweep calls the mean over its captures
UNITS = {"PSNR": "dB"}
DIGITS = 9  # by which a number of the table is found among those of its runs
MARKERS, LINES = "os^Dv", ("-", "--", ":", "-.")
K_PANEL_IN = (2.6, 2.3)
A_K_SWEEP = "make one with `ggvs-eval sweep k FOLDER --capture CAPTURE`"
DRAWN = ("PSNR", "LPIPS", "TCC")
RATE_PANEL_IN = (3.4, 2.6)
A_STREAM_SWEEP = "make one with `ggvs-eval sweep stream FOLDER --capture CAPTURE`"


def read_k_table(sweep: Path) -> pd.DataFrame:
    """Return the table of a sweep over K: rows (method, K), ascending in K; of several captures their mean."""
    file = sweep / SWEEP_FILE
    if not file.is_file():
        raise ResultsError(f"{sweep}: wanted the folder of a sweep, it has no {SWEEP_FILE}; {A_K_SWEEP}")
    table = pd.read_csv(file)
    if "capture" in table:
        table = table[table["capture"] == MEAN]
    table["K"] = [int(match[1]) if (match := re.fullmatch(r"k(\d+)", str(name))) else -1 for name in table["variant"]]
    table = table[table["K"] > 0]
    if table["K"].nunique() < 2:
        raise ResultsError(f"{file}: wanted at least two numbers of source views, got {table['K'].nunique()}; {A_K_SWEEP}")
    return (
        table.drop(columns=["capture", "variant"], errors="ignore")
        .set_index(["method", "K"])
        .sort_index(level="K", sort_remaining=False)
    )


def sweep_runs(sweep: Path) -> list[Path]:
    """Return the run folders of a sweep that its table has lines of, in their order there."""
    table = pd.read_csv(sweep / SWEEP_FILE, dtype={"capture": str, "variant": str}).fillna({"capture": ""})
    if "capture" not in table:
        return [sweep / variant for variant in dict.fromkeys(table["variant"])]
    names = dict.fromkeys(zip(table["capture"], table["variant"], strict=True))
    return [sweep / capture / variant for capture, variant in names if capture != MEAN]


def interval_widths(sweep: Path, metric: str) -> dict[tuple[int, float], float]:
    """Return half width of the interval of each number of a sweep over K, found by K and the number itself, rounded.

    The table of a sweep has its own titles, and its numbers are those of its runs: a number that no run has any more, or a
    mean over data sets, has no interval.
    """
    scored = [read_scores(run) for run in sweep_runs(sweep) if RunFolder(run).protocol_file.is_file()]
    widths: dict[tuple[int, float], float] = {}
    for protocol in dict.fromkeys(run.protocol for run in scored):
        results = merge_results([run.results for run in scored if run.protocol == protocol])
        for dataset in dict.fromkeys(results.table["dataset"]):
            for interval in intervals(results, metric, str(dataset)).values():
                if interval.half_width is not None:
                    widths[protocol.synthesis.k, round(interval.value, DIGITS)] = interval.half_width
    return widths


def draw_k(
    sweep: Path,
    out: Path,
    metrics: tuple[str, ...] = (),
    look: FigureLook | None = None,
    numbers: Mapping[str, int] | None = None,
) -> Path:
    """Return a panel per metric and one for the time of a frame, a line per method; each K that was evaluated is a marker.

    Bars are 95 % intervals, as in the tables of the single runs.

    Args:
        sweep: folder that ``ggvs-eval sweep`` has made.
        metrics: which; PSNR and LPIPS, where they were measured, by default.
        look: width.
        numbers: name of a method -> number of its colour; those of the table in their order, where None.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    table = read_k_table(sweep)
    names = metrics or tuple(name for name in USUAL if name in table)
    absent = [name for name in names if name not in table]
    if absent:
        raise ResultsError(f"{sweep / SWEEP_FILE}: no {', '.join(absent)}; it has {', '.join(table.columns)}")
    panels = (*names, *((SECONDS,) if SECONDS in table and SECONDS not in names else ()))
    width = look.width_in if look else K_PANEL_IN[0] * len(panels)
    figure = Figure(figsize=(width, K_PANEL_IN[1]), layout="constrained")
    numbers = numbers or method_numbers(table.index.get_level_values("method"))
    for axes, metric in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        widths = {} if metric == SECONDS else interval_widths(sweep, metric)
        for method in dict.fromkeys(table.index.get_level_values("method")):
            number, values = numbers[method], table.loc[method, metric].dropna()
            style = {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)], "markersize": 4}
            bars = [widths.get((int(k), round(value, DIGITS)), 0.0) for k, value in values.items()]
            line = LINES[number % len(LINES)]
            axes.errorbar(values.index, values, bars, fmt=line, label=method, linewidth=1.2, capsize=2, elinewidth=0.8, **style)
        unit = f" ({UNITS[metric]})" if metric in UNITS else ""
        axes.set_ylabel("seconds per frame" if metric == SECONDS else f"{metric}{unit}", fontsize=7)
        axes.set_xlabel("number of source views K", fontsize=7)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.tick_params(labelsize=6)
        if metric == SECONDS:
            axes.set_ylim(bottom=0)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=7, frameon=False)
    return save_figure(figure, out)


@dataclass(frozen=True)
class Mark:
    """One method at one size and K: pictures per second, the number on the screen, and the number where each is waited for."""

    title: str
    per_second: float
    seen: float
    waited: float


@dataclass(frozen=True)
class Family:
    """A method at all sizes and K, slowest first."""

    name: str
    marks: tuple[Mark, ...]


@dataclass(frozen=True)
class RatePanel:
    """One metric over pictures per second, on a logarithmic axis.

    Attributes:
        axes: metric, unit and direction; its places across are decimal logarithms of the rate.
        fps: rate of the cameras, which a method must reach to show every frame.
        families: one per method.
    """

    axes: Panel
    fps: float
    families: tuple[Family, ...]

    def x(self, per_second: float) -> float:
        """Return the horizontal place of a rate in the drawing, in its pixels."""
        return self.axes.x(math.log10(per_second))

    def line(self, family: Family) -> str:
        """Displayed quality of a method, as the points of an SVG polyline."""
        return " ".join(f"{self.x(mark.per_second)},{self.axes.y(mark.seen)}" for mark in family.marks)


def rate_panels(runs: Sequence[MeasuredRun]) -> tuple[RatePanel, ...]:
    """Return a panel per metric of runs that differ in K alone, or of one; none if nothing is on a screen."""
    streams = {run.protocol.stream for run in runs}
    (stream,) = streams if len(streams) == 1 else (None,)
    if stream is None:
        return ()
    return tuple(panel for metric in DRAWN if (panel := _panel(runs, metric, stream.fps)))


def _panel(runs: Sequence[MeasuredRun], metric: str, fps: float) -> RatePanel | None:
    note = next((run.metrics[metric] for run in runs if metric in run.metrics), None)
    if note is None:
        return None
    marks: dict[str, list[Mark]] = {}
    names: dict[str, str] = {}
    for run in runs:
        for label, mark in _marks(run, metric, several=len(runs) > 1):
            family = re.sub(r"\+scale=[^+]*", "", label)
            marks.setdefault(family, []).append(mark)
            names.setdefault(family, re.sub(r", scale=[^,]*", "", run.name(label)))
    every = [mark for of_family in marks.values() for mark in of_family]
    if not every:
        return None
    families = [
        Family(names[label], tuple(sorted(of_family, key=lambda mark: mark.per_second))) for label, of_family in marks.items()
    ]
    rates = [fps, *(mark.per_second for mark in every)]
    values = [value for mark in every for value in (mark.seen, mark.waited)]
    bounds = (math.log10(min(rates)) - 0.08, math.log10(max(rates)) + 0.08, *with_margin(min(values), max(values)))
    better = "higher is better" if note.higher_is_better else "lower is better"
    return RatePanel(Panel(metric, note.unit, better, "", (), bounds), fps, tuple(families))


def _marks(run: MeasuredRun, metric: str, several: bool) -> list[tuple[str, Mark]]:
    """Return the methods of a run that have a rate and both numbers."""
    file = run.folder.stream_record
    records = read_json(file)["methods"] if file.is_file() else {}
    summary = run.results.summary().droplevel("dataset")
    values = {label_of(*names): summary.loc[names] for names in summary.index}
    at_k = f", K = {run.protocol.synthesis.k}" if several else ""
    found = []
    for label in run.labels:
        per_second, of_label = records.get(label, {}).get("per_second"), values.get(label, {})
        seen, waited = (float(of_label.get(name, math.nan)) for name in (f"{metric}{ON_SCREEN}", metric))
        if per_second and math.isfinite(seen) and math.isfinite(waited):
            found.append((label, Mark(f"{run.name(label)}{at_k}", per_second, seen, waited)))
    return found


def draw_rates(panels: Sequence[RatePanel], out: Path, numbers: Mapping[str, int] | None = None) -> Path:
    """Draw the panels side by side, for print, in the colours of `numbers`, see `method_numbers`.

    Raises:
        ResultsError: no panels.
    """
    from matplotlib.figure import Figure

    if not panels:
        raise ResultsError(f"{out}: no method is on a screen in these runs; {A_STREAM_SWEEP}")
    figure = Figure(figsize=(RATE_PANEL_IN[0] * len(panels), RATE_PANEL_IN[1]), layout="constrained")
    numbers = numbers or method_numbers(family.name for panel in panels for family in panel.families)
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        axes.set_xscale("log")
        axes.axvline(panel.fps, color="#999999", linewidth=0.8, linestyle=":", label="rate of the cameras")
        for family in panel.families:
            colour, rates = COLOURS[numbers[family.name] % len(COLOURS)], [mark.per_second for mark in family.marks]
            axes.plot(
                rates, [mark.seen for mark in family.marks], "o-", color=colour, markersize=4, label=family.name, linewidth=1
            )
            axes.plot(rates, [mark.waited for mark in family.marks], "o", color=colour, markersize=4, fillstyle="none")
            for mark in family.marks:
                axes.plot([mark.per_second] * 2, [mark.seen, mark.waited], color=colour, linewidth=0.5, alpha=0.5)
        unit = f" ({panel.axes.unit})" if panel.axes.unit else ""
        axes.set_ylabel(f"{panel.axes.metric}{unit} as displayed", fontsize=7)
        axes.set_xlabel("pictures per second", fontsize=7)
        texts = [text for _, text in panel.axes.logarithmic_ticks()]
        axes.set_xticks([float(text) for text in texts], texts)
        axes.set_xticks([], minor=True)
        axes.tick_params(labelsize=6)
        axes.grid(alpha=0.25, linewidth=0.5)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=6, frameon=False)
    return save_figure(figure, out)
