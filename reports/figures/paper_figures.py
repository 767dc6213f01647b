"""The figures of a paper, each by its kind, as PNG and PDF; and the video that goes with it.

Frames of every method stand next to the reference, with the squares that a rule has chosen enlarged
below or next to them.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.images import read_image, resize
from ggvs_eval.files.video import write_video
from ggvs_eval.reports.figures.axes import COLOURS, save_figure
from ggvs_eval.reports.figures.look import FULL_LOOK, FigureLook, only_methods, score_words
from ggvs_eval.reports.figures.regions import (
    ERROR_FULL_SCALE,
    RULES,
    Region,
    Rule,
    Square,
    find_regions,
    given_regions,
    read_errors,
)
from ggvs_eval.reports.model.measured import MeasuredRun, read_run
from ggvs_eval.reports.section import Draw, FigurePlaces, Report, SectionContent
from ggvs_eval.run_folder import frame_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# light ones, which stand out from pictures
BOX_COLOURS = (COLOURS[4], COLOURS[5], COLOURS[3], COLOURS[2])
TINY, SMALL = 6, 7
LETTERS_PER_IN = 20  # of the small font
WIDEST = 3840  # pixels, which players and journals take
IN_ONE_ROW = 3  # pictures; more are arranged in rows
STRIP = 32  # pixels, the height of a name
DEFAULT_FPS = 10.0
FigureKind = Literal["crops", "failures", "epi", "time", "k", "stream", "video"]
BOTH = (".png", ".pdf")


def write_figure(
    folder: Path,
    kind: FigureKind,
    out: Path,
    *,
    rule: Rule = "different",
    method: str | None = None,
    boxes: int = 2,
    view: str | None = None,
    frame: int | None = None,
    row: int | None = None,
    metrics: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
    squares: tuple[Square, ...] = (),
    look: FigureLook | None = None,
    has_scores: bool = False,
) -> tuple[Path, ...]:
    """Write a figure.

    Args:
        folder: run folder, rendered and scored; of ``k`` the folder of a sweep.
        kind: ``crops`` of one frame, ``failures`` of a method, slices ``epi`` and ``time``, the
            curves over ``k``, ``stream``: quality on the screen over pictures per second, or a
            ``video`` of the methods side by side.
        out: file to write; without a suffix both a PNG and a PDF.
        rule: by which crops are chosen, see `ggvs_eval.reports.figures.regions.RULES`.
        method: label whose worst squares are shown; ours without a variant, or the first, where
            None.
        metrics: panels of ``k``, scores of the others.
        methods: labels of those that are shown, in this order; all by default.
        squares: of crops, instead of those that the rule finds.
        look: width and title; each kind's own width where None.
        has_scores: whether each method's scores follow its name.

    Raises:
        ResultsError: as of the single figures, or no boxes.
    """
    if boxes < 1:
        raise ResultsError(f"--boxes: wanted at least 1, got {boxes}")
    if kind == "video":
        return (
            write_side_by_side(
                only_methods(read_run(folder), methods),
                out if out.suffix else out.with_suffix(".mp4"),
                view,
            ),
        )
    files = (out,) if out.suffix else tuple(out.with_suffix(suffix) for suffix in BOTH)
    if kind == "k":  # figures of other parts, each of which this module is used without
        from ggvs_eval.reports.figures.sweep_figures import draw_k

        return tuple(draw_k(folder, file, metrics, look) for file in files)
    look, run = look or FULL_LOOK, only_methods(read_run(folder), methods)
    scores = score_words(run, metrics) if has_scores else {}
    if kind in ("epi", "time"):
        from ggvs_eval.reports.figures.slices import draw_slices, slices_of

        slices = slices_of(run, kind, row, view)
        return tuple(draw_slices(slices, file, look, scores) for file in files)
    if kind == "stream":
        from ggvs_eval.reports.figures.stream import draw_rates, rate_panels

        return tuple(draw_rates(rate_panels([run]), file) for file in files)
    if not run.pictured:
        why = "; ".join(f"{label} {reason}" for label, reason in run.results.set_aside.items())
        raise ResultsError(
            f"{run.folder.root}: wanted a method with every frame, got none: {why}; render the "
            f"missing frames"
        )
    label = method or run.ours_first[0]
    if kind == "failures":
        return draw_failures(run, files, label, boxes, look)
    if squares:
        return draw_crops(
            run, files, given_regions(run, squares, view, frame), "chosen manually", look, scores
        )
    regions = find_regions(run, rule, label, boxes, view=view, frame=frame)
    return draw_crops(run, files, regions, RULES[rule].format(name=run.name(label)), look, scores)


def draw_crops(
    run: MeasuredRun,
    files: Sequence[Path],
    regions: Sequence[Region],
    rule: str,
    look: FigureLook = FULL_LOOK,
    scores: Mapping[str, str] | None = None,
) -> tuple[Path, ...]:
    """Return one frame of every method with its boxes, and below it what is in each box, with the
    mean absolute error there.

    Args:
        regions: squares of one and the same frame.
        rule: who chose them, in words.
        look: width and title.
        scores: label of a method -> text below its name.
    """
    pictures = _pictures(run, regions[0])
    errors = read_errors(run, regions[0].view, regions[0].frame)
    height, width = pictures["truth"].shape[:2]
    column_in = look.width_in / len(pictures)
    size = (look.width_in, 0.5 + column_in * height / width + len(regions) * (column_in + 0.12))
    figure, axes = _grid(size, [height / width, *[1.0] * len(regions)], len(pictures))
    longest = int(column_in * LETTERS_PER_IN)
    for across, (key, picture) in enumerate(pictures.items()):
        score_text = (scores or {}).get(key, "").replace(", ", "\n")
        _show(axes[0, across], picture, f"{run.name(key)}\n{score_text}", longest)
        for number, region in enumerate(regions):
            _box(axes[0, across], region, number)
            _show(
                axes[1 + number, across],
                _cut(picture, region),
                "" if key == "truth" else f"L1 {_l1(errors[key], region):.1f}",
            )
            # in the colour of the box that is shown
            for spine in axes[1 + number, across].spines.values():
                spine.set(edgecolor=BOX_COLOURS[number % len(BOX_COLOURS)], linewidth=1.6)
    if look.has_title:
        figure.suptitle(
            f"{regions[0].view}, frame {regions[0].frame}; boxes: {rule}", fontsize=SMALL, wrap=True
        )
    return tuple(save_figure(figure, file) for file in files)


def draw_failures(
    run: MeasuredRun,
    files: Sequence[Path],
    label: str,
    cases: int = 3,
    look: FigureLook = FULL_LOOK,
) -> tuple[Path, ...]:
    """Return the worst squares of a method, one per view: place, reference, every method, and the
    method's error map.
    """
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
            name, error_text = (
                "" if down else names[key],
                "" if key == "truth" else f"\nL1 {_l1(errors[key], region):.1f}",
            )
            _show(axes[down, across], _cut(pictures[key], region), f"{name}{error_text}", longest)
        picture = axes[down, -1].imshow(
            _cut(errors[label], region), cmap="magma", vmin=0, vmax=ERROR_FULL_SCALE
        )
        _bare(axes[down, -1], "" if down else error_of, longest)
    bar = figure.colorbar(picture, ax=axes[:, -1], fraction=0.08, pad=0.04)
    bar.ax.tick_params(labelsize=TINY)
    bar.set_label("grey levels of 255", fontsize=TINY)
    if look.has_title:
        figure.suptitle(
            f"Squares {RULES['worst'].format(name=run.name(label))}, the worst of each view",
            fontsize=SMALL,
        )
    return tuple(save_figure(figure, file) for file in files)


def _grid(size: tuple[float, float], heights: list[float], columns: int) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(len(heights), columns, squeeze=False, height_ratios=heights)


def _pictures(run: MeasuredRun, region: Region) -> dict[str, Image8]:
    """Return label -> whole frame, the truth first."""
    return {
        key: read_image(frame_path(folder, region.frame))
        for key, folder in run.frame_folders(region.view).items()
    }


def _cut(picture: Any, region: Region) -> Any:
    return picture[region.top : region.top + region.side, region.left : region.left + region.side]


def _l1(errors: Any, region: Region) -> float:
    return float(np.mean(_cut(errors, region)))


def _show(axes: "Axes", picture: Image8, title: str, longest: int = 22) -> None:
    # repeats pixels where it enlarges much, averages where it reduces
    axes.imshow(picture, interpolation="antialiased")
    _bare(axes, title, longest)


def _bare(axes: "Axes", title: str, longest: int = 22) -> None:
    axes.set(xticks=[], yticks=[])
    axes.set_title(_wrap(title, longest), fontsize=TINY, pad=2)


def _wrap(title: str, longest: int) -> str:
    """A long name in lines, so that it does not run into its neighbour's.

    Options (``history_tolerance=0.02``) as words.
    """
    import textwrap

    return "\n".join(
        line
        for part in title.splitlines()
        for line in textwrap.wrap(re.sub("[_=]", " ", part), longest)
    )


def _box(axes: "Axes", region: Region, number: int) -> None:
    from matplotlib.patches import Rectangle

    corner = (region.left - 0.5, region.top - 0.5)
    colour = BOX_COLOURS[number % len(BOX_COLOURS)]
    axes.add_patch(
        Rectangle(corner, region.side, region.side, fill=False, edgecolor=colour, linewidth=1.2)
    )


def write_side_by_side(run: MeasuredRun, out: Path, view: str | None = None) -> Path:
    """Write the video; pictures keep their size, unless all of them would be wider than `WIDEST`.

    Args:
        run: rendered; the truth and its methods are shown, in their order.
        out: MP4 file to write.
        view: test view; None takes the first.

    Raises:
        ResultsError: no such view, another suffix, or a single frame.
    """
    views = run.protocol.views.test
    view = view or views[0]
    if view not in views:
        raise ResultsError(
            f"{run.folder.root}: no test view {view!r}; use one of {', '.join(views)}"
        )
    if out.suffix != ".mp4":
        raise ResultsError(
            f"{out}: a video's name must end in .mp4, got {out.suffix or 'no suffix'}"
        )
    if len(run.frames) < 2:
        raise ResultsError(
            f"{run.folder.root}: one frame is no video; draw `ggvs-eval figure crops`"
        )
    folders = run.frame_folders(view)
    write_video(out, _frames(run, folders), float(run.capture.get("fps") or DEFAULT_FPS))
    return out


def _frames(run: MeasuredRun, folders: dict[str, Path]) -> Iterator[Image8]:
    """Yield all pictures of each instant on one sheet."""
    columns = len(folders) if len(folders) <= IN_ONE_ROW else math.ceil(math.sqrt(len(folders)))
    full_height, full_width, _ = read_image(frame_path(folders["truth"], run.frames[0])).shape
    width = min(full_width, WIDEST // columns)
    height = round(full_height * width / full_width)
    names = [_strip(run.name(key), width) for key in folders]
    for frame in run.frames:
        pictures = [
            resize(read_image(frame_path(folder, frame)), width, height, "area")
            for folder in folders.values()
        ]
        yield _sheet([np.concatenate(pair) for pair in zip(names, pictures, strict=True)], columns)


def _sheet(pictures: Sequence[Image8], columns: int) -> Image8:
    """Return the pictures of one size in rows, black if there is none, of even width and height."""
    height, width, _ = pictures[0].shape
    rows = math.ceil(len(pictures) / columns)
    sheet = np.zeros(
        (rows * height + rows * height % 2, columns * width + columns * width % 2, 3), np.uint8
    )
    for at, picture in enumerate(pictures):
        top, left = at // columns * height, at % columns * width
        sheet[top : top + height, left : left + width] = picture
    return sheet


def _strip(name: str, width: int) -> Image8:
    """Return a name in white on black, (STRIP, width, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    canvas = FigureCanvasAgg(Figure(figsize=(width / 100, STRIP / 100), dpi=100, facecolor="black"))
    points = min(12.0, 1.2 * width / max(len(name), 1))  # a letter is about 0.6 of its size wide
    canvas.figure.text(0.5, 0.5, name, color="white", ha="center", va="center", fontsize=points)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:STRIP, :width, :3].copy()


def crops_section(report: Report) -> SectionContent:
    """Return two figures of each run: the squares in which methods differ most, and the worst ones
    of the first method.
    """

    def figures(places: FigurePlaces) -> Iterator[Draw]:
        for key, run in report.runs.items():
            if run.pictured:
                label = run.ours_first[0]
                rule: Rule = "different" if len(run.pictured) > 1 else "worst"
                regions = find_regions(run, rule, label, 2)
                words = RULES[rule].format(name=run.name(label))
                yield partial(draw_crops, run, [places.folders[key] / "crops.png"], regions, words)
                yield partial(draw_failures, run, [places.folders[key] / "failures.png"], label)

    return SectionContent(figures=figures)
