"""Frames of every method beside the truth, with the squares that a rule has chosen enlarged below or beside them."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import read_image
from ggvs_eval.reports.figures.curves import COLOURS, save_figure
from ggvs_eval.reports.figures.look import FULL_LOOK, FigureLook
from ggvs_eval.reports.figures.regions import ERROR_FULL_SCALE, RULES, Region, find_regions, read_errors
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.run_folder import frame_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BOX_COLOURS = (COLOURS[4], COLOURS[5], COLOURS[3], COLOURS[2])  # light ones, which stand out from pictures
TINY, SMALL = 6, 7
LETTERS_PER_IN = 20  # of the small font


def draw_crops(
    run: MeasuredRun,
    files: Sequence[Path],
    regions: Sequence[Region],
    rule: str,
    look: FigureLook = FULL_LOOK,
    scores: Mapping[str, str] | None = None,
) -> tuple[Path, ...]:
    """One frame of every method with its boxes, and below it what is in each box, with the mean absolute error there.

    Args:
        regions: squares of one and the same frame.
        rule: who chose them, in words.
        look: width and title.
        scores: label of a method -> what stands below its name.
    """
    pictures = _pictures(run, regions[0])
    errors = read_errors(run, regions[0].view, regions[0].frame)
    height, width = pictures["truth"].shape[:2]
    column_in = look.width_in / len(pictures)
    size = (look.width_in, 0.5 + column_in * height / width + len(regions) * (column_in + 0.12))
    figure, axes = _grid(size, [height / width, *[1.0] * len(regions)], len(pictures))
    longest = int(column_in * LETTERS_PER_IN)
    for across, (key, picture) in enumerate(pictures.items()):
        told = (scores or {}).get(key, "").replace(", ", "\n")
        _show(axes[0, across], picture, f"{run.name(key)}\n{told}", longest)
        for number, region in enumerate(regions):
            _box(axes[0, across], region, number)
            _show(axes[1 + number, across], _cut(picture, region), "" if key == "truth" else f"L1 {_l1(errors[key], region):.1f}")
            _frame(axes[1 + number, across], number)
    if look.has_title:
        figure.suptitle(f"{regions[0].view}, frame {regions[0].frame}; boxes: {rule}", fontsize=SMALL, wrap=True)
    return tuple(save_figure(figure, file) for file in files)


def draw_failures(
    run: MeasuredRun, files: Sequence[Path], label: str, cases: int = 3, look: FigureLook = FULL_LOOK
) -> tuple[Path, ...]:
    """The worst squares of a method, one per view: where they lie, the truth, every method, and the method's error as a map."""
    regions = find_regions(run, "worst", label, cases, one_per_view=True)
    labels = ("truth", *run.pictured)
    column_in = look.width_in / (len(labels) + 2)
    longest = int(column_in * LETTERS_PER_IN)
    names = {key: _wrap(run.name(key), longest) for key in labels}
    error_of = _wrap(f"error of {run.name(label)}", longest)
    most_lines = max(text.count("\n") + 1 for text in (*names.values(), error_of))
    height_in = 0.3 + 0.1 * most_lines + (column_in + 0.25) * len(regions)
    figure, axes = _grid((look.width_in, height_in), [1.0] * len(regions), len(labels) + 2)
    for down, region in enumerate(regions):
        pictures = _pictures(run, region)
        errors = read_errors(run, region.view, region.frame)
        _show(axes[down, 0], pictures[label], f"{region.view}, frame {region.frame}", longest)
        _box(axes[down, 0], region, 0)
        for across, key in enumerate(labels, start=1):
            name, told = "" if down else names[key], "" if key == "truth" else f"\nL1 {_l1(errors[key], region):.1f}"
            _show(axes[down, across], _cut(pictures[key], region), f"{name}{told}", longest)
        shown = axes[down, -1].imshow(_cut(errors[label], region), cmap="magma", vmin=0, vmax=ERROR_FULL_SCALE)
        _bare(axes[down, -1], "" if down else error_of, longest)
    bar = figure.colorbar(shown, ax=axes[:, -1], fraction=0.08, pad=0.04)
    bar.ax.tick_params(labelsize=TINY)
    bar.set_label("grey levels of 255", fontsize=TINY)
    if look.has_title:
        figure.suptitle(f"Squares {RULES['worst'].format(name=run.name(label))}, the worst of each view", fontsize=SMALL)
    return tuple(save_figure(figure, file) for file in files)


def _grid(size: tuple[float, float], heights: list[float], columns: int) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(len(heights), columns, squeeze=False, height_ratios=heights)


def _pictures(run: MeasuredRun, region: Region) -> dict[str, Image8]:
    """Label -> whole frame, the truth first."""
    return {key: read_image(frame_path(folder, region.frame)) for key, folder in run.frame_folders(region.view).items()}


def _cut(picture: Any, region: Region) -> Any:
    return picture[region.top : region.top + region.side, region.left : region.left + region.side]


def _l1(errors: Any, region: Region) -> float:
    return float(np.mean(_cut(errors, region)))


def _show(axes: "Axes", picture: Image8, title: str, longest: int = 22) -> None:
    axes.imshow(picture, interpolation="antialiased")  # repeats pixels where it enlarges much, averages where it reduces
    _bare(axes, title, longest)


def _bare(axes: "Axes", title: str, longest: int = 22) -> None:
    axes.set(xticks=[], yticks=[])
    axes.set_title(_wrap(title, longest), fontsize=TINY, pad=2)


def _wrap(title: str, longest: int) -> str:
    """A long name in lines, so that it does not run into its neighbour's; options (``history_tolerance=0.02``) as words."""
    import textwrap

    return "\n".join(line for part in title.splitlines() for line in textwrap.wrap(re.sub("[_=]", " ", part), longest))


def _box(axes: "Axes", region: Region, number: int) -> None:
    from matplotlib.patches import Rectangle

    corner = (region.left - 0.5, region.top - 0.5)
    colour = BOX_COLOURS[number % len(BOX_COLOURS)]
    axes.add_patch(Rectangle(corner, region.side, region.side, fill=False, edgecolor=colour, linewidth=1.2))


def _frame(axes: "Axes", number: int) -> None:
    """Edges in the colour of the box that is shown."""
    for spine in axes.spines.values():
        spine.set(edgecolor=BOX_COLOURS[number % len(BOX_COLOURS)], linewidth=1.6)
