"""Figure of metric studies: the answer of each metric to each degradation, a field of cells for
each study.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ggvs_eval.contrib.study.metric_study import Study, answered_metrics, read_study
from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.figures.axes import save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CELL_IN = (0.235, 0.175)
LABELS_IN, HEAD_IN, FOOT_IN, GAP_IN = 1.35, 0.75, 0.6, 0.12
WIDE_IN = 4.0  # from which on the legend fits into one line
# Okabe and Ito's blue and vermillion, which colour-blind readers can distinguish.
SEES, REWARDS, ABSENT = "#0072b2", "#d55e00", "#e6e6e6"
LEGEND = {
    SEES: "worse with strength",
    REWARDS: "better with strength",
    "white": "blind",
    ABSENT: "not computed",
}


def draw_study(folders: Mapping[str, Path], out: Path) -> Path:
    """Return a field of cells for each study, metrics down, degradations across, rank correlations
    in them.

    Args:
        folders: title of the field -> folder of a metric study.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    studies = {title: read_study(folder) for title, folder in folders.items()}
    rows = answered_metrics(list(studies.values()))
    if not rows:
        raise ResultsError(
            f"{', '.join(map(str, folders.values()))}: wanted responses of metrics to draw, got "
            f"none; add metrics"
        )
    counts = [len(study["ladders"]) for study in studies.values()]
    width = LABELS_IN + sum(counts) * CELL_IN[0] + len(counts) * GAP_IN
    height = HEAD_IN + len(rows) * CELL_IN[1] + FOOT_IN
    figure = Figure(figsize=(width, height))
    left = LABELS_IN
    for number, (title, study) in enumerate(studies.items()):
        size = counts[number] * CELL_IN[0], len(rows) * CELL_IN[1]
        axes = figure.add_axes((left / width, FOOT_IN / height, size[0] / width, size[1] / height))
        _draw_field(axes, study, rows, title)
        if number == 0:
            axes.set_yticks(np.arange(len(rows)), rows, fontsize=6)
        left += size[0] + GAP_IN
    patches = [
        Patch(facecolor=colour, edgecolor="#bbbbbb", linewidth=0.5, label=label)
        for colour, label in LEGEND.items()
    ]
    columns = len(patches) if width > WIDE_IN else 2
    figure.legend(
        handles=patches,
        loc="lower center",
        ncols=columns,
        fontsize=6,
        frameon=False,
        handlelength=1.2,
    )
    return save_figure(figure, out)


def _draw_field(axes: "Axes", study: Study, rows: Sequence[str], title: str) -> None:
    from matplotlib.colors import to_rgb

    ladders = list(study["ladders"])
    field = np.ones((len(rows), len(ladders), 3))
    for column, ladder in enumerate(ladders):
        for row, metric in enumerate(rows):
            answer = study["answers"][ladder].get(metric)
            if answer is None:
                field[row, column] = to_rgb(ABSENT)
                continue
            correlation, is_blind = answer["correlation"], answer["verdict"] == "blind"
            share = 0.0 if is_blind else 0.15 + 0.85 * abs(correlation)
            field[row, column] = 1 - share * (
                1 - np.array(to_rgb(SEES if correlation > 0 else REWARDS))
            )
            ink = "white" if share > 0.6 else "#555555" if is_blind else "black"
            axes.text(
                column, row, _short(correlation), fontsize=5, ha="center", va="center", color=ink
            )
    axes.imshow(field, aspect="auto", interpolation="nearest")
    axes.set_xticks(
        np.arange(len(ladders)), ladders, fontsize=6, rotation=60, ha="left", rotation_mode="anchor"
    )
    axes.set_yticks([])
    axes.tick_params(top=True, bottom=False, labeltop=True, labelbottom=False, length=0, pad=2)
    axes.set_xticks(np.arange(1, len(ladders)) - 0.5, minor=True)
    axes.set_yticks(np.arange(1, len(rows)) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=0.8)
    groups = [study["metrics"].get(metric, {}).get("group") for metric in rows]
    for row in range(1, len(rows)):
        if None not in (groups[row], groups[row - 1]) and groups[row] != groups[row - 1]:
            axes.axhline(row - 0.5, color="#444444", linewidth=0.7)
    axes.tick_params(which="minor", length=0)
    for spine in axes.spines.values():
        spine.set_color("#bbbbbb")
        spine.set_linewidth(0.5)
    axes.set_xlabel(title, fontsize=7, labelpad=4)


def _short(correlation: float) -> str:
    """Return two digits at most: 1, .87, -.4."""
    text = (
        f"{correlation:.2f}".rstrip("0")
        .rstrip(".")
        .replace("0.", ".", 1)
        .replace("-", "\N{MINUS SIGN}")
    )
    return "0" if text in ("", ".", "\N{MINUS SIGN}0", "\N{MINUS SIGN}") else text
