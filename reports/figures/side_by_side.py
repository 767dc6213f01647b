"""A video of the truth and every method beside each other, each under its name, for the supplement of a paper."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.images import read_image, resize
from ggvs_eval.files.video import write_video
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.run_folder import frame_path

WIDEST = 3840  # pixels, which players and journals take
IN_ONE_ROW = 3  # pictures; more stand in rows
STRIP = 32  # pixels, the height of a name
DEFAULT_FPS = 10.0


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
        raise ResultsError(f"{run.folder.root}: no test view {view!r}; use one of {', '.join(views)}")
    if out.suffix != ".mp4":
        raise ResultsError(f"{out}: a video's name must end in .mp4, got {out.suffix or 'no suffix'}")
    if len(run.frames) < 2:
        raise ResultsError(f"{run.folder.root}: one frame is no video; draw `ggvs-eval figure crops`")
    folders = run.frame_folders(view)
    write_video(out, _frames(run, folders), float(run.capture.get("fps") or DEFAULT_FPS))
    return out


def _frames(run: MeasuredRun, folders: dict[str, Path]) -> Iterator[Image8]:
    """All pictures of each instant on one sheet."""
    columns = len(folders) if len(folders) <= IN_ONE_ROW else math.ceil(math.sqrt(len(folders)))
    full_height, full_width, _ = read_image(frame_path(folders["truth"], run.frames[0])).shape
    width = min(full_width, WIDEST // columns)
    height = round(full_height * width / full_width)
    names = [_strip(run.name(key), width) for key in folders]
    for frame in run.frames:
        pictures = [resize(read_image(frame_path(folder, frame)), width, height, "area") for folder in folders.values()]
        yield _sheet([np.concatenate(pair) for pair in zip(names, pictures, strict=True)], columns)


def _sheet(pictures: Sequence[Image8], columns: int) -> Image8:
    """Pictures of one size in rows, black where there is none, of even width and height."""
    height, width, _ = pictures[0].shape
    rows = math.ceil(len(pictures) / columns)
    sheet = np.zeros((rows * height + rows * height % 2, columns * width + columns * width % 2, 3), np.uint8)
    for at, picture in enumerate(pictures):
        top, left = at // columns * height, at % columns * width
        sheet[top : top + height, left : left + width] = picture
    return sheet


def _strip(name: str, width: int) -> Image8:
    """A name in white on black, (STRIP, width, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    canvas = FigureCanvasAgg(Figure(figsize=(width / 100, STRIP / 100), dpi=100, facecolor="black"))
    points = min(12.0, 1.2 * width / max(len(name), 1))  # a letter is about 0.6 of its size wide
    canvas.figure.text(0.5, 0.5, name, color="white", ha="center", va="center", fontsize=points)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:STRIP, :width, :3].copy()
