"""Quality and time over the number of source views K, from the table of a sweep."""

import re
from pathlib import Path

import pandas as pd

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.figures.curves import COLOURS, save_figure

SWEEP_FILE = "sweep.csv"
SECONDS = "s/frame"
USUAL = ("PSNR", "LPIPS")
UNITS = {"PSNR": "dB"}
MARKERS, LINES = "os^Dv", ("-", "--", ":", "-.")
PANEL_IN = (2.6, 2.3)
AN_EXAMPLE = "make one with `ggvs-eval sweep k FOLDER --capture CAPTURE`"


def read_k_table(sweep: Path) -> pd.DataFrame:
    """The table of a sweep over K: rows (method, K), rising in K; of several captures their mean."""
    file = sweep / SWEEP_FILE
    if not file.is_file():
        raise ResultsError(f"{sweep}: wanted the folder of a sweep, it has no {SWEEP_FILE}; {AN_EXAMPLE}")
    table = pd.read_csv(file)
    if "capture" in table:
        table = table[table["capture"] == "mean"]
    table["K"] = [int(match[1]) if (match := re.fullmatch(r"k(\d+)", str(name))) else -1 for name in table["variant"]]
    table = table[table["K"] > 0]
    if table["K"].nunique() < 2:
        raise ResultsError(f"{file}: wanted at least two numbers of source views, got {table['K'].nunique()}; {AN_EXAMPLE}")
    return (
        table.drop(columns=["capture", "variant"], errors="ignore")
        .set_index(["method", "K"])
        .sort_index(level="K", sort_remaining=False)
    )


def draw_k(sweep: Path, out: Path, metrics: tuple[str, ...] = ()) -> Path:
    """A panel per metric and one for the time of a frame, a line per method; each K that was evaluated is a marker.

    Args:
        sweep: folder that ``ggvs-eval sweep`` has made.
        metrics: which; PSNR and LPIPS, where they were measured, by default.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    table = read_k_table(sweep)
    names = metrics or tuple(name for name in USUAL if name in table)
    absent = [name for name in names if name not in table]
    if absent:
        raise ResultsError(f"{sweep / SWEEP_FILE}: no {', '.join(absent)}; it has {', '.join(table.columns)}")
    panels = (*names, *((SECONDS,) if SECONDS in table and SECONDS not in names else ()))
    figure = Figure(figsize=(PANEL_IN[0] * len(panels), PANEL_IN[1]), layout="constrained")
    for axes, metric in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for number, method in enumerate(dict.fromkeys(table.index.get_level_values("method"))):
            values = table.loc[method, metric].dropna()
            look = {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)], "markersize": 4}
            axes.plot(values.index, values, LINES[number % len(LINES)], label=method, linewidth=1.2, **look)
        unit = f" ({UNITS[metric]})" if metric in UNITS else ""
        axes.set_ylabel("seconds per frame" if metric == SECONDS else f"{metric}{unit}", fontsize=7)
        axes.set_xlabel("number of source views K", fontsize=7)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.tick_params(labelsize=6)
        if metric == SECONDS:
            axes.set_ylim(bottom=0)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=7, frameon=False)
    return save_figure(figure, out)
