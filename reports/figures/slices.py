"""Slices through a sequence: the row of an image over viewpoints (epipolar plane image) or over
time (x-t).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.images import read_image
from ggvs_eval.jobs.processes import in_threads
from ggvs_eval.reports.figures.axes import round_ticks, save_figure
from ggvs_eval.reports.figures.data_uris import LOSSLESS, shrink, webp_uri
from ggvs_eval.reports.figures.look import FULL_LOOK, FigureLook
from ggvs_eval.reports.figures.regions import comparison_weight
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.section import RUNS_KEPT, Draw, FigurePlaces, Report, SectionContent
from ggvs_eval.run_folder import frame_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SliceKind = Literal["epi", "time"]
# of frames or poses that are looked at for the row in which methods differ most
INDICES_AT_MOST = 10
CONTEXT_SHARE = 0.35
BREAKS_AT_MOST = 3  # of each strip
BREAK_WIDTH = 9  # columns that one is averaged over
BREAK_APART = 24  # columns between two at one time
BREAK_LEAST = 8.0  # levels of 255; noise and codec stay below it
BREAK_TIMES = 4.0  # times the median of the strip
NO_PATH = (
    "Imported renders have no path; use `ggvs-eval figure time`, or render a path by "
    "`ggvs-eval run`"
)
NO_TRUTH = "no reference on a virtual path"
CONTEXT_WIDTH = 480


@dataclass(frozen=True)
class Break:
    """A place at which a slice changes from one sample to the next where the truth does not, or the
    other way round.

    Attributes:
        at: number of the later sample, from 0.
        x: column, pixels.
        apart: how far its change since the sample before is from the truth's, mean over a few
            columns, levels of 255.
    """

    at: int
    x: int
    apart: float


@dataclass(frozen=True)
class Strip:
    """The slice of one method: (samples, x, 3), or None for a truth that does not exist."""

    label: str
    name: str
    image: Image8 | None
    breaks: tuple[Break, ...] = ()


@dataclass(frozen=True)
class Slices:
    """The same slice of every method.

    Attributes:
        kind: ``epi`` or ``time``.
        view: test view of an x-t slice; empty for an epipolar plane image.
        chosen_by: who chose the row, in words.
        strips: the truth first, then every method.
        context: frame that the row is taken from.
        title: what the slice is of.
        motion: mean change of the row over time, grey levels of 255; 0 along a path.
        first: number of its first sample, a frame or a pose.
        fps: samples per second; 0 if they are none of time, or it is unknown.
    """

    kind: SliceKind
    view: str
    row: int
    chosen_by: str
    strips: tuple[Strip, ...]
    context: Image8
    title: str
    motion: float = 0.0
    first: int = 0
    fps: float = 0.0


def stacked_rows(folder: Path, indices: range, row: int) -> Image8:
    """Stack one row of frames; read one by one, so that memory does not grow with the images.

    Args:
        folder: ``0000.png``, ... one per frame or pose.

    Returns:
        (samples, x, 3): along a camera path an epipolar plane image, in which a scene point is a
        line whose slope grows with its nearness; over time in a fixed view static content is a
        vertical line, and flicker is horizontal noise.
    """

    def read_row(index: int) -> Image8:
        image = read_image(frame_path(folder, index))
        height = image.shape[0]
        if not 0 <= row < height:
            raise ResultsError(
                f"{frame_path(folder, index)}: no row {row} in an image of {height} rows; use "
                f"0..{height - 1}"
            )
        return image[row].copy()

    return np.stack(list(in_threads(read_row, indices)))


def find_breaks(image: Image8, truth: Image8) -> tuple[Break, ...]:
    """Return the places at which a slice changes most unlike the truth, the largest first.

    None if noise would explain them.

    Args:
        image: slice of a method, (samples, x, 3).
        truth: the same slice of the truth, same shape.

    Reading:
        Of the change of each sample to the next the truth's is taken away, channel by channel, and
        the mean over the channels and over a few columns is what counts: flicker and jumps are in
        it, what moves in the truth too is not.
    """
    if len(image) < 2 or image.shape != truth.shape:
        return ()
    # (samples - 1, W, 3)
    changes, true_changes = (
        np.diff(picture.astype(np.float32), axis=0) for picture in (image, truth)
    )
    # (samples - 1, W)
    apart = cv2.blur(np.abs(changes - true_changes).mean(axis=2), (BREAK_WIDTH, 1))
    least = max(BREAK_LEAST, BREAK_TIMES * float(np.median(apart)))
    breaks: list[Break] = []
    while len(breaks) < BREAKS_AT_MOST and float(apart.max()) >= least:
        at, x = (int(place) for place in np.unravel_index(int(apart.argmax()), apart.shape))
        breaks.append(Break(at + 1, x, float(apart[at, x])))
        apart[max(0, at - 1) : at + 2, max(0, x - BREAK_APART) : x + BREAK_APART + 1] = 0.0
    return tuple(breaks)


def _with_breaks(strips: Sequence[Strip]) -> tuple[Strip, ...]:
    """Strips, the truth first, each with the places at which it breaks.

    None if there is no truth.
    """
    truth = strips[0].image
    if truth is None:
        return tuple(strips)
    return tuple(
        strip
        if strip.image is None or strip is strips[0]
        else replace(strip, breaks=find_breaks(strip.image, truth))
        for strip in strips
    )


def change_of_rows(folder: Path, frames: range) -> NDArray[np.float64]:
    """Return the mean change of each row of a fixed view from frame to frame, (H,), grey levels of
    255; zeros of one frame.
    """
    previous = read_image(frame_path(folder, frames[0])).astype(np.int16)
    change = np.zeros(len(previous))
    for index in frames[1:]:
        image = read_image(frame_path(folder, index)).astype(np.int16)
        change += np.abs(image - previous).mean(axis=(1, 2)) / (len(frames) - 1)
        previous = image
    return change


def most_textured_row(images: Iterable[Image8]) -> int:
    """Return the row with the strongest horizontal gradients, summed over images of one size."""
    # (H,)
    strength = sum(
        np.abs(np.diff(image.astype(np.int16), axis=1)).mean(axis=(1, 2)) for image in images
    )
    return int(np.argmax(strength))


def most_different_row(folders: Mapping[str, Path], indices: range) -> int | None:
    """Return the textured row in which the methods' weighted absolute errors differ most.

    None where fewer than two differ.

    Args:
        folders: label -> frames, those of the truth as ``truth``; without it the mean of the
            methods represents it.
        indices: frames or poses, of which at most `INDICES_AT_MOST` are looked at, evenly spaced.
    """
    labels = [label for label in folders if label != "truth"]
    if len(labels) < 2:
        return None
    apart: np.ndarray | float = 0.0
    texture: np.ndarray | float = 0.0  # (H,), of the truth
    totals: np.ndarray | float = 0.0  # (methods, H)
    for index in indices[:: -(-len(indices) // INDICES_AT_MOST)]:
        images = np.stack(
            [read_image(frame_path(folders[label], index)).astype(np.float32) for label in labels]
        )
        truth = (
            read_image(frame_path(folders["truth"], index))
            if "truth" in folders
            else images.mean(axis=0)
        )
        weight = comparison_weight(truth, images)  # (H, W)
        texture = texture + weight.mean(axis=1)
        errors = (np.einsum("mhwc->mhw", np.abs(images - truth)) / 3 * weight).mean(axis=2)
        totals, apart = totals + errors, apart + errors.mean(axis=0)
    if "truth" in folders:
        apart = np.ptp(totals, axis=0)
    return int(np.argmax(apart * texture)) if np.max(apart) > 0 else None


def path_slices(run: MeasuredRun, row: int | None = None) -> Slices | None:
    """Return the epipolar plane images of the truth and every method.

    None if the run has no camera path.

    Reading:
        The paper fixes a row without saying which; unless one is given, it is the row in which
        methods differ most. Where there is one method alone, or all are equal, it is the one with
        the strongest horizontal gradients in the middle pose of the truth, or of all methods
        together on a virtual path, which has no truth.
    """
    folders, n_poses = run.path_folders(run.labels)
    if not n_poses:
        return None
    middle = {
        label: read_image(frame_path(folder, n_poses // 2)) for label, folder in folders.items()
    }
    of_truth = "truth" in folders
    chosen_by = (
        f"the strongest horizontal gradients in the middle pose of "
        f"{'the reference' if of_truth else 'all methods together'}"
    )
    row, chosen_by = _choose_row(
        row,
        folders,
        range(n_poses),
        lambda: most_textured_row([middle["truth"]] if of_truth else middle.values()),
        chosen_by,
    )
    strips = [
        Strip(label, run.name(label), stacked_rows(folder, range(n_poses), row))
        for label, folder in folders.items()
    ]
    if not of_truth:
        strips.insert(0, Strip("truth", run.name("truth"), None))
    context = next(iter(middle.values()))
    return Slices(
        kind="epi",
        view="",
        row=row,
        chosen_by=chosen_by,
        strips=_with_breaks(strips),
        context=context,
        title=f"{n_poses} poses along the camera path",
    )


def time_slices(run: MeasuredRun, view: str, row: int | None = None) -> Slices:
    """x-t slices of the truth and every method in one view.

    Reading:
        The paper fixes a row without saying which; unless one is given, it is the row in which the
        truth changes most over time: in still rows all methods look alike. In a still view it is
        the row in which methods differ most.
    """
    views = run.protocol.views.test
    if view not in views:
        raise ResultsError(
            f"{run.folder.root}: no test view {view!r}; use one of {', '.join(views)}"
        )
    folders = run.frame_folders(view)
    change = change_of_rows(folders["truth"], run.frames)
    if row is not None:
        chosen_by = "given"
    elif change.any():
        row, chosen_by = (
            int(np.argmax(change)),
            "the largest change of the reference from frame to frame",
        )
    else:
        row, chosen_by = _choose_row(
            None, folders, run.frames, lambda: len(change) // 2, "the middle"
        )
    strips = _with_breaks(
        [
            Strip(label, run.name(label), stacked_rows(folder, run.frames, row))
            for label, folder in folders.items()
        ]
    )
    context = read_image(frame_path(folders["truth"], run.frames[len(run.frames) // 2]))
    title, fps = f"{len(run.frames)} frames of {view}", float(run.capture.get("fps") or 0)
    return Slices(
        kind="time",
        view=view,
        row=row,
        chosen_by=chosen_by,
        strips=strips,
        context=context,
        title=title,
        motion=float(change.max()),
        first=run.frames[0],
        fps=fps,
    )


def _choose_row(
    row_given: int | None,
    folders: Mapping[str, Path],
    indices: range,
    otherwise: Callable[[], int],
    words: str,
) -> tuple[int, str]:
    """The row, and who chose it in words: anyone who asked for one, the methods' differences, or
    else a rule on the pictures.
    """
    if row_given is not None:
        return row_given, "given"
    if (row := most_different_row(folders, indices)) is not None:
        return row, "where the methods differ most"
    return otherwise(), words


@lru_cache(maxsize=RUNS_KEPT)
def all_slices(run: MeasuredRun) -> Sequence[Slices]:
    """Return the slices that the page shows: the camera path if there is one, and each view over
    time if time passes.
    """
    path = path_slices(run)
    over_time = (
        [time_slices(run, view) for view in run.protocol.views.test] if len(run.frames) > 1 else []
    )
    return ([path] if path else []) + over_time


def slices_of(run: MeasuredRun, kind: SliceKind, row: int | None, view: str | None) -> Slices:
    """Return the epipolar plane images or x-t slices of every method and the truth of a run.

    Args:
        kind: ``epi`` along the camera path, ``time`` in a fixed view.
        row: image row; None chooses one and the figure says how.
        view: test view of ``time``; None takes the first.

    Raises:
        ResultsError: no camera path in it, no such view or row.
    """
    slices = (
        path_slices(run, row)
        if kind == "epi"
        else time_slices(run, view or run.protocol.views.test[0], row)
    )
    if slices is None:
        raise ResultsError(
            f"{run.folder.root}: no method has frames along a camera path. {NO_PATH}"
        )
    return slices


def draw_slices(
    slices: Slices, out: Path, look: FigureLook = FULL_LOOK, scores: Mapping[str, str] | None = None
) -> Path:
    """Draw slices below each other, with the frame that they cut on top.

    Args:
        out: file to write; its suffix chooses the format (``.png``, ``.pdf``, ``.svg``).
        look: width and title.
        scores: label of a method -> text after its name.

    Raises:
        ResultsError: a suffix that is not a picture's.
    """
    from matplotlib.figure import Figure

    context_in = look.width_in * CONTEXT_SHARE * slices.context.shape[0] / slices.context.shape[1]
    figure = Figure(
        figsize=(look.width_in, 0.6 + context_in + 0.95 * len(slices.strips)), layout="constrained"
    )
    axes = figure.subplots(
        1 + len(slices.strips), 1, height_ratios=[context_in, *[0.8] * len(slices.strips)]
    )
    axes[0].imshow(slices.context)
    axes[0].axhline(slices.row, color="#ff3b30", linewidth=1.2)
    if look.has_title:
        axes[0].set_title(
            f"Row {slices.row} in {slices.title}\n(row: {slices.chosen_by})", fontsize=8
        )
    axes[0].set_axis_off()
    for axis, strip in zip(axes[1:], slices.strips, strict=True):
        axis.set_title(
            "   ".join(filter(None, (strip.name, (scores or {}).get(strip.label)))),
            loc="left",
            fontsize=8,
            pad=2,
        )
        if strip.image is None:
            axis.text(
                0.5, 0.5, NO_TRUTH, ha="center", va="center", fontsize=8, transform=axis.transAxes
            )
            axis.set(xticks=[], yticks=[])
            continue
        _draw_strip(axis, strip.image, slices, is_last=axis is axes[-1])
    axes[-1].set_xlabel("x (pixel)", fontsize=7)
    return save_figure(figure, out)


def _draw_strip(axis: "Axes", image: Image8, slices: Slices, is_last: bool) -> None:
    """One slice with the numbers of its samples left, and seconds right of it where time passes at
    a known rate.
    """
    from matplotlib.ticker import MaxNLocator

    samples, width = image.shape[:2]
    first, fps = slices.first, slices.fps
    axis.imshow(
        image,
        aspect="auto",
        interpolation="nearest",
        extent=(0, width, first + samples - 0.5, first - 0.5),
    )
    axis.set_ylabel("v (pose)" if slices.kind == "epi" else "t (frame)", fontsize=7)
    axis.yaxis.set_major_locator(MaxNLocator(3, integer=True))
    axis.tick_params(labelsize=6, labelbottom=is_last)
    if fps:
        to_and_from_seconds = (
            lambda frames: (frames - first) / fps,
            lambda seconds: seconds * fps + first,
        )
        seconds = axis.secondary_yaxis("right", functions=to_and_from_seconds)
        seconds.yaxis.set_major_locator(MaxNLocator(3))
        seconds.set_ylabel("t (s)", fontsize=7)
        seconds.tick_params(labelsize=6)


def slices_section(report: Report) -> SectionContent:
    """Return the slices of each run, for the page and as figures.

    The viewer opens at the view and row that move most.
    """
    slices_of_runs = {key: all_slices(run) for key, run in report.runs.items()}
    values = {}
    data: dict[str, dict[str, int]] = {}
    for key, of_run in slices_of_runs.items():
        has_path = any(slices.kind == "epi" for slices in of_run)
        values[key] = {"slices": list(map(_pictures, of_run)), "has_path": has_path}
        if over_time := [slices for slices in of_run if slices.kind == "time"]:
            livest = max(over_time, key=lambda slices: slices.motion)
            values[key]["opening_view"], data[key] = livest.view, {"row": livest.row}

    def figures(places: FigurePlaces) -> Iterator[Draw]:
        for key, of_run in slices_of_runs.items():
            for slices in of_run:
                name = "epi" if slices.kind == "epi" else f"x-t_{slices.view}"
                yield partial(draw_slices, slices, places.folders[key] / f"{name}.png")

    return SectionContent(values=values, data=data, figures=figures)


def _pictures(slices: Slices) -> dict[str, Any]:
    """Return what the page shows of slices, pictures as data URIs."""
    height, width = slices.context.shape[:2]
    count = next(len(strip.image) for strip in slices.strips if strip.image is not None)
    seconds = {
        at: f"{at / slices.fps:.2f} s" if slices.fps else ""
        for at in sorted({0, count // 2, count - 1})
    }
    return {
        "samples": [
            (round(100 * (at + 0.5) / count, 2), str(slices.first + at), second)
            for at, second in seconds.items()
        ],
        "pixels": [(round(100 * value / width, 2), text) for value, text in round_ticks(0, width)],
        "has_seconds": slices.fps > 0,
        "kind": slices.kind,
        "view": slices.view,
        "row": slices.row,
        "chosen_by": slices.chosen_by,
        "title": slices.title,
        "context": webp_uri(shrink(slices.context, CONTEXT_WIDTH)),
        "size": (width, height),
        "strips": [_picture_of_strip(slices, strip) for strip in slices.strips],
        "no_truth": NO_TRUTH if any(strip.image is None for strip in slices.strips) else "",
    }


def _picture_of_strip(slices: Slices, strip: Strip) -> dict[str, Any]:
    """A slice as a picture, and its breaks: place in per cent, words, and what of an address leads
    there (over time alone).
    """
    if strip.image is None:
        return {"name": strip.name, "picture": None}
    count, width = strip.image.shape[:2]
    number, breaks = ("frame" if slices.kind == "time" else "pose"), []
    for gap in strip.breaks:
        words = (
            f"{number} {slices.first + gap.at}, column {gap.x}: changes by {gap.apart:.0f} "
            f"levels more or less than the reference"
        )
        view, label = quote(slices.view, safe=""), quote(strip.label, safe="")
        place = f"{view}/{slices.first + gap.at}/{gap.x},{slices.row}/{label},truth"
        left, top = round(100 * (gap.x + 0.5) / width, 2), round(100 * gap.at / count, 2)
        breaks.append(
            {
                "left": left,
                "top": top,
                "words": words,
                "place": place if slices.kind == "time" else "",
            }
        )
    return {"name": strip.name, "picture": webp_uri(strip.image, LOSSLESS), "breaks": breaks}
