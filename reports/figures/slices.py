"""Slices through a sequence: the row of an image over viewpoints (epipolar plane image) or over time (x-t)."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.images import read_image
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.reports.figures.curves import save_figure
from ggvs_eval.reports.model.measured import MeasuredRun, read_run
from ggvs_eval.run_folder import frame_path, require_frames

SliceKind = Literal["epi", "time"]
WIDTH_IN = 7.0
CONTEXT_SHARE = 0.35
NO_TRUTH = "no truth on a virtual path"


@dataclass(frozen=True)
class Strip:
    """The slice of one method: (samples, x, 3), or None for a truth that does not exist."""

    name: str
    image: Image8 | None


@dataclass(frozen=True)
class Slices:
    """The same slice of every method.

    Attributes:
        kind: ``epi`` or ``time``.
        view: test view of an x-t slice; empty for an epipolar plane image.
        row: image row.
        chosen_by: who chose the row, in words.
        strips: the truth first, then every method.
        context: frame that the row is taken from.
        title: what the slice is of.
    """

    kind: SliceKind
    view: str
    row: int
    chosen_by: str
    strips: tuple[Strip, ...]
    context: Image8
    title: str


def epipolar_plane_image(folder: Path, n_poses: int, row: int) -> Image8:
    """One row of the images along a camera path, stacked.

    Args:
        folder: ``0000.png``, ... one per pose.
        n_poses: number of poses.
        row: image row, from the top.

    Returns:
        (v, x, 3), v the pose; a scene point is a line whose slope grows with its nearness.

    Raises:
        ResultsError: no such row.
    """
    return _stack_rows(folder, range(n_poses), row)


def temporal_slice(folder: Path, frames: range, row: int) -> Image8:
    """One row of the frames of a fixed view, stacked over time.

    Args:
        folder: frames named by their number.
        frames: which of them.
        row: image row, from the top.

    Returns:
        (t, x, 3); what stands still is a vertical line, flicker is horizontal noise.

    Raises:
        ResultsError: no such row.
    """
    return _stack_rows(folder, frames, row)


def _stack_rows(folder: Path, indices: range, row: int) -> Image8:
    """Read image by image and keep one row of each, so that memory does not grow with the images."""

    def read_row(index: int) -> Image8:
        image = read_image(frame_path(folder, index))
        height = image.shape[0]
        if not 0 <= row < height:
            raise ResultsError(f"{frame_path(folder, index)}: no row {row} in an image of {height} rows; use 0..{height - 1}")
        return image[row].copy()

    with ThreadPoolExecutor(default_workers()) as threads:  # decoding lets go of the interpreter
        return np.stack(list(threads.map(read_row, indices)))


def most_changing_row(folder: Path, frames: range) -> int:
    """The row of a fixed view with the largest mean change from frame to frame."""
    change: np.ndarray | float = 0.0
    previous: np.ndarray | None = None
    for index in frames:
        image = read_image(frame_path(folder, index)).astype(np.int16)
        if previous is not None:
            change = change + np.abs(image - previous).mean(axis=(1, 2))  # (H,)
        previous = image
    return int(np.argmax(change)) if np.ndim(change) else (0 if previous is None else previous.shape[0] // 2)


def most_textured_row(images: Iterable[Image8]) -> int:
    """The row with the strongest horizontal gradients, summed over images of one size."""
    strength = sum(np.abs(np.diff(image.astype(np.int16), axis=1)).mean(axis=(1, 2)) for image in images)  # (H,)
    return int(np.argmax(strength))


def path_folders(run: MeasuredRun, labels: Iterable[str]) -> tuple[dict[str, Path], int]:
    """Find the frames along the camera path: the folders of the truth and of methods, and the number of poses.

    Args:
        labels: the methods; those without a path are left out.

    Returns:
        Label -> folder, and the number of poses, 0 where the run has no path.

    Raises:
        RenderError: poses are missing.
    """
    counts = {label: len(list(run.folder.path(label).glob("*.png"))) for label in ("truth", *labels)}
    folders = {label: run.folder.path(label) for label, count in counts.items() if count}  # none of a path that was refused
    n_poses = max(counts.values())
    require_frames({f"{run.name(label)} on the path": folder for label, folder in folders.items()}, range(n_poses))
    return folders, n_poses


def path_slices(run: MeasuredRun, row: int | None = None) -> Slices | None:
    """Epipolar plane images of the truth and every method; None where the run has no camera path.

    Reading:
        The paper fixes a row without saying which; unless one is given, it is the row with the strongest horizontal gradients in
        the middle pose of the truth, or of all methods together on a virtual path, which has no truth.

    Raises:
        RenderError: poses are missing.
        ResultsError: no such row.
    """
    folders, n_poses = path_folders(run, run.labels)
    if not n_poses:
        return None
    middle = {label: read_image(frame_path(folder, n_poses // 2)) for label, folder in folders.items()}
    of_truth = "truth" in folders
    chosen_by = _asked(row) or (
        f"the strongest horizontal gradients in the middle pose of {'the truth' if of_truth else 'all methods together'}"
    )
    row = most_textured_row([middle["truth"]] if of_truth else middle.values()) if row is None else row
    strips = [Strip(run.name(label), epipolar_plane_image(folder, n_poses, row)) for label, folder in folders.items()]
    if not of_truth:
        strips.insert(0, Strip(run.name("truth"), None))
    context = next(iter(middle.values()))
    return Slices("epi", "", row, chosen_by, tuple(strips), context, f"{n_poses} poses along the camera path")


def time_slices(run: MeasuredRun, view: str, row: int | None = None) -> Slices:
    """x-t slices of the truth and every method in one view.

    Reading:
        The paper fixes a row without saying which; unless one is given, it is the row in which the truth changes most over time.

    Raises:
        ResultsError: no such view or row.
    """
    views = run.protocol.views.test
    if view not in views:
        raise ResultsError(f"{run.folder.root}: no test view {view!r}; use one of {', '.join(views)}")
    folders = run.frame_folders(view)
    chosen_by = _asked(row) or "the largest change of the truth from frame to frame"
    row = most_changing_row(folders["truth"], run.frames) if row is None else row
    strips = tuple(Strip(run.name(label), temporal_slice(folder, run.frames, row)) for label, folder in folders.items())
    context = read_image(frame_path(folders["truth"], run.frames[len(run.frames) // 2]))
    return Slices("time", view, row, chosen_by, strips, context, f"{len(run.frames)} frames of {view}")


def all_slices(run: MeasuredRun) -> Sequence[Slices]:
    """Return the slices that the page shows: the camera path if there is one, and each view over time if time passes."""
    path = path_slices(run)
    over_time = [time_slices(run, view) for view in run.protocol.views.test] if len(run.frames) > 1 else []
    return ([path] if path else []) + over_time


def write_slices(run: Path, kind: SliceKind, row: int | None, view: str | None, out: Path) -> Path:
    """Write epipolar plane images or x-t slices of every method and the truth of a run.

    Args:
        run: run folder, rendered and scored.
        kind: ``epi`` along the camera path, ``time`` in a fixed view.
        row: image row; None chooses one and the figure says how.
        view: test view of ``time``; None takes the first.
        out: file to write; its suffix chooses the format (``.png``, ``.pdf``, ``.svg``).

    Returns:
        The file.

    Raises:
        ResultsError: not a scored run, no camera path in it, no such view or row, or a suffix that is not a picture's.
    """
    measured = read_run(run)
    slices = path_slices(measured, row) if kind == "epi" else time_slices(measured, view or measured.protocol.views.test[0], row)
    if slices is None:
        raise ResultsError(f"{run}: no frames along a camera path under path/, wanted for an EPI; run `ggvs-eval render` again")
    return draw_slices(slices, out)


def _asked(row: int | None) -> str:
    return "" if row is None else "asked for"


def draw_slices(slices: Slices, out: Path) -> Path:
    """Draw slices below each other, with the frame that they cut on top."""
    from matplotlib.figure import Figure

    context_in = WIDTH_IN * CONTEXT_SHARE * slices.context.shape[0] / slices.context.shape[1]
    figure = Figure(figsize=(WIDTH_IN, 0.6 + context_in + 0.95 * len(slices.strips)), layout="constrained")
    axes = figure.subplots(1 + len(slices.strips), 1, height_ratios=[context_in, *[0.8] * len(slices.strips)])
    axes[0].imshow(slices.context)
    axes[0].axhline(slices.row, color="#ff3b30", linewidth=1.2)
    axes[0].set_title(f"Row {slices.row} in {slices.title}\n(row: {slices.chosen_by})", fontsize=8)
    axes[0].set_axis_off()
    for axis, strip in zip(axes[1:], slices.strips, strict=True):
        axis.set_title(strip.name, loc="left", fontsize=8, pad=2)
        if strip.image is None:
            axis.text(0.5, 0.5, NO_TRUTH, ha="center", va="center", fontsize=8, transform=axis.transAxes)
            axis.set(xticks=[], yticks=[])
            continue
        samples, width = strip.image.shape[:2]
        axis.imshow(strip.image, aspect="auto", interpolation="nearest", extent=(0, width, samples, 0))
        axis.set_ylabel("v (pose)" if slices.kind == "epi" else "t (frame)", fontsize=7)
        axis.tick_params(labelsize=6, labelbottom=axis is axes[-1])
    axes[-1].set_xlabel("x (pixel)", fontsize=7)
    return save_figure(figure, out)
