"""Figures of sweeps: quality and time over the number of source views K."""

import re
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from ggvs_eval.errors import ResultsError
from ggvs_eval.merged_results import merge_results
from ggvs_eval.reports.figures.axes import COLOURS, method_numbers, save_figure
from ggvs_eval.reports.figures.look import USUAL, FigureLook
from ggvs_eval.reports.model.measured import MEAN_OF_CAPTURES, SWEEP_FILE, read_scores, sweep_runs
from ggvs_eval.run_folder import SCREEN_TITLE, RunFolder
from ggvs_eval.statistics.intervals import intervals

SECONDS = "s/frame"
UNITS = {"PSNR": "dB"}
DIGITS = 9  # by which a number of the table is found among those of its runs
MARKERS, LINES = "os^Dv", ("-", "--", ":", "-.")
K_PANEL_IN = (2.6, 2.3)
A_K_SWEEP = "make one with `ggvs-eval sweep k FOLDER --capture CAPTURE`"


def read_k_table(sweep: Path) -> pd.DataFrame:
    """Return the table of a sweep over K: rows (method, K), ascending in K.

    Of several captures their mean.
    """
    file = sweep / SWEEP_FILE
    if not file.is_file():
        raise ResultsError(
            f"{sweep}: wanted the folder of a sweep, it has no {SWEEP_FILE}; {A_K_SWEEP}"
        )
    table = pd.read_csv(file)
    table = table[~table["method"].str.endswith(SCREEN_TITLE)]
    if "capture" in table:
        table = table[table["capture"] == MEAN_OF_CAPTURES]
    table["K"] = [
        int(match[1]) if (match := re.fullmatch(r"k(\d+)", str(name))) else -1
        for name in table["variant"]
    ]
    table = table[table["K"] > 0]
    if table["K"].nunique() < 2:
        raise ResultsError(
            f"{file}: wanted at least two numbers of source views, got {table['K'].nunique()}; "
            f"{A_K_SWEEP}"
        )
    return (
        table.drop(columns=["capture", "variant"], errors="ignore")
        .set_index(["method", "K"])
        .sort_index(level="K", sort_remaining=False)
    )


def interval_widths(sweep: Path, metric: str) -> dict[tuple[int, float], float]:
    """Return half width of the interval of each number of a sweep over K, found by K and the number
    itself, rounded.

    The table of a sweep has its own titles, and its numbers are those of its runs: a number that no
    run has any more, or a mean over data sets, has no interval.
    """
    scored = [
        read_scores(run) for run in sweep_runs(sweep) if RunFolder(run).protocol_file.is_file()
    ]
    widths: dict[tuple[int, float], float] = {}
    for protocol in dict.fromkeys(run.protocol for run in scored):
        results = merge_results([run.results for run in scored if run.protocol == protocol])
        for dataset in dict.fromkeys(results.table["dataset"]):
            for interval in intervals(results, metric, str(dataset)).values():
                if interval.half_width is not None:
                    widths[protocol.synthesis.k, round(interval.value, DIGITS)] = (
                        interval.half_width
                    )
    return widths


def draw_k(
    sweep: Path,
    out: Path,
    metrics: tuple[str, ...] = (),
    look: FigureLook | None = None,
    numbers: Mapping[str, int] | None = None,
) -> Path:
    """Return a panel per metric and one for the time of a frame, a line per method.

    Each K that was evaluated is a marker.

    Bars are 95 % intervals, as in the tables of the single runs.

    Args:
        sweep: folder that ``ggvs-eval sweep`` has made.
        metrics: which; PSNR and LPIPS, where they were measured, by default.
        look: width.
        numbers: name of a method -> number of its colour; those of the table in their order, where
            None.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    table = read_k_table(sweep)
    names = metrics or tuple(name for name in USUAL if name in table)
    absent = [name for name in names if name not in table]
    if absent:
        raise ResultsError(
            f"{sweep / SWEEP_FILE}: no {', '.join(absent)}; it has {', '.join(table.columns)}"
        )
    panels = (*names, *((SECONDS,) if SECONDS in table and SECONDS not in names else ()))
    width = look.width_in if look else K_PANEL_IN[0] * len(panels)
    figure = Figure(figsize=(width, K_PANEL_IN[1]), layout="constrained")
    numbers = numbers or method_numbers(table.index.get_level_values("method"))
    for axes, metric in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        widths = {} if metric == SECONDS else interval_widths(sweep, metric)
        for method in dict.fromkeys(table.index.get_level_values("method")):
            number, values = numbers[method], table.loc[method, metric].dropna()
            style = {
                "color": COLOURS[number % len(COLOURS)],
                "marker": MARKERS[number % len(MARKERS)],
                "markersize": 4,
            }
            bars = [widths.get((int(k), round(value, DIGITS)), 0.0) for k, value in values.items()]
            line = LINES[number % len(LINES)]
            axes.errorbar(
                values.index,
                values,
                bars,
                fmt=line,
                label=method,
                linewidth=1.2,
                capsize=2,
                elinewidth=0.8,
                **style,
            )
        unit = f" ({UNITS[metric]})" if metric in UNITS else ""
        axes.set_ylabel("seconds per frame" if metric == SECONDS else f"{metric}{unit}", fontsize=7)
        axes.set_xlabel("number of source views K", fontsize=7)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.tick_params(labelsize=6)
        if metric == SECONDS:
            axes.set_ylim(bottom=0)
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=4,
        fontsize=7,
        frameon=False,
    )
    return save_figure(figure, out)
