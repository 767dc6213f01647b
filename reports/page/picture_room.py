"""How much of the page the pictures of each run may take."""

from collections.abc import Sequence
from dataclasses import dataclass

from ggvs_eval.files.images import read_image
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.page.comparison import FRAME_BYTES, FRAMES_AT_MOST
from ggvs_eval.reports.page.method_videos import VIDEO_BYTES
from ggvs_eval.reports.page.path_pictures import PATH_BYTES, POSES_AT_MOST
from ggvs_eval.run_folder import frame_path


@dataclass(frozen=True)
class PictureRoom:
    """Bytes that the pictures of one run may take, before base64.

    Attributes:
        frames: of the viewer.
        path: along the camera path.
        videos: all of them together.
    """

    frames: int
    path: int
    videos: int


def share_room(runs: Sequence[MeasuredRun]) -> list[PictureRoom]:
    """Share the page among runs by the pixels that each has to show, so that a small room takes nothing from a large one."""
    pixels = [_frame_pixels(run) for run in runs]
    frames = _shares([pixel * min(_n_frames(run), FRAMES_AT_MOST) for pixel, run in zip(pixels, runs, strict=True)])
    paths = _shares([pixel * min(_n_poses(run), POSES_AT_MOST) for pixel, run in zip(pixels, runs, strict=True)])
    return [
        PictureRoom(int(FRAME_BYTES * frame), int(PATH_BYTES * path), int(VIDEO_BYTES * frame))
        for frame, path in zip(frames, paths, strict=True)
    ]


def _shares(weights: Sequence[int]) -> list[float]:
    total = sum(weights)
    return [weight / total if total else 0.0 for weight in weights]


def _frame_pixels(run: MeasuredRun) -> int:
    """Pixels of a frame."""
    height, width, _ = read_image(frame_path(run.folder.truth(run.protocol.views.test[0]), run.frames[0])).shape
    return height * width


def _n_frames(run: MeasuredRun) -> int:
    """Frames of the truth and of all methods."""
    return len(run.frames) * len(run.protocol.views.test) * (1 + len(run.pictured))


def _n_poses(run: MeasuredRun) -> int:
    """Pictures along the camera path, of the truth and of all methods."""
    return sum(len(list(run.folder.path(key).glob("*.png"))) for key in ("truth", *run.pictured))
