"""Moving pictures of the page: a video per method, the frames along the camera path, and each run's budget of bytes."""

import base64
import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import read_image
from ggvs_eval.files.video import write_video
from ggvs_eval.reports.figures.slices import path_folders
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.page.comparison import FRAME_BYTES, FRAMES_AT_MOST, diagnostics_folders, diagnostics_label
from ggvs_eval.reports.page.data_uri import fitting_width, shrink, webp_uri
from ggvs_eval.run_folder import frame_path

VIDEO_BYTES = 3_000_000
VIDEO_FRAMES_AT_MOST = 300
WIDTHS = (480, 320, 240, 160)
CRF = 26.0  # for looking at; x264's own default is 23
DEFAULT_FPS = 10.0
PATH_BYTES = 3_000_000
POSES_AT_MOST = 480  # over all methods; the browser decodes each of them for one row


@dataclass(frozen=True)
class MethodVideo:
    """The video of one method or of the truth.

    Attributes:
        name: of the method, to show.
        views: test views in the order in which they appear.
        width: pixels.
        height: pixels.
        address: the video as text that the page carries.
    """

    name: str
    views: tuple[str, ...]
    width: int
    height: int
    address: str


def method_videos(run: MeasuredRun, fps: float, byte_budget: int = VIDEO_BYTES) -> tuple[MethodVideo, ...]:
    """Encode the truth and every method, at the largest width at which all fit; none for a run of one frame.

    Args:
        fps: frames per second of the capture; 0 where unknown, then `DEFAULT_FPS`.
        byte_budget: what all videos may take together, before base64; the narrowest width is taken where nothing fits.

    Reading:
        Long runs are cut: as many whole views as `VIDEO_FRAMES_AT_MOST` frames hold, at least the beginning of one.
    """
    if len(run.frames) < 2:
        return ()
    views = run.protocol.views.test[: max(1, VIDEO_FRAMES_AT_MOST // len(run.frames))]
    keys = ("truth", *run.pictured)
    for width in WIDTHS:
        with ThreadPoolExecutor(os.cpu_count()) as pool:  # codecs release the GIL
            videos = list(pool.map(partial(_encode, run, views, width, fps or DEFAULT_FPS), keys))
        if sum(len(video) for video, *_ in videos) <= byte_budget:
            break
    addresses = ["data:video/mp4;base64," + base64.b64encode(video).decode("ascii") for video, *_ in videos]
    return tuple(
        MethodVideo(run.name(key), views, width, height, address)
        for key, (_, width, height), address in zip(keys, videos, addresses, strict=True)
    )


def _encode(run: MeasuredRun, views: tuple[str, ...], width: int, fps: float, key: str) -> tuple[bytes, int, int]:
    folders = [run.frame_folders(view)[key] for view in views]
    first = next(_pictures(folders[:1], run.frames, width))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "video.mp4"
        write_video(file, _pictures(folders, run.frames, width), fps, CRF)
        return file.read_bytes(), first.shape[1], first.shape[0]


def _pictures(folders: list[Path], frames: range, width: int) -> Iterator[Image8]:
    """Frames of folder after folder, reduced, a last odd row or column cut off (4:2:0 wants even sizes)."""
    for folder in folders:
        for frame in frames[:VIDEO_FRAMES_AT_MOST]:
            image = shrink(read_image(frame_path(folder, frame)), width)
            yield image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]


@dataclass(frozen=True)
class PathPictures:
    """Path frames from which the page can cut epipolar plane images.

    Attributes:
        poses: numbers of the poses shown, every so many-th one.
        keys: ``truth``, where the path has one, the labels that have a path, and what one of them decided inside.
        images: key -> one picture per pose shown.
    """

    poses: tuple[int, ...]
    keys: tuple[str, ...]
    images: dict[str, list[str]]


def path_pictures(run: MeasuredRun, byte_budget: int = PATH_BYTES) -> PathPictures | None:
    """Compress the frames along the camera path; None where the run has none.

    Args:
        byte_budget: what they may take, before base64; it decides their width.
    """
    folders, count = path_folders(run, run.pictured)
    if not count:
        return None
    poses = range(0, count, math.ceil(count * len(folders) / POSES_AT_MOST))
    told = diagnostics_label(run)
    if told in folders:
        folders |= dict(diagnostics_folders(folders[told], told, range(count)))
    files = {key: [frame_path(folder, pose) for pose in poses] for key, folder in folders.items()}
    middle = [read_image(paths[len(paths) // 2]) for paths in files.values()]
    width = fitting_width(middle, byte_budget / (len(poses) * len(folders)))
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # OpenCV's codecs release the GIL
        compress = partial(_compress, width)
        images = {key: list(pool.map(compress, paths)) for key, paths in files.items()}
    return PathPictures(tuple(poses), tuple(folders), images)


def _compress(width: int, file: Path) -> str:
    return webp_uri(shrink(read_image(file), width))


@dataclass(frozen=True)
class PictureRoom:
    """Bytes that the pictures of one run may take, before base64."""

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
    height, width, _ = read_image(frame_path(run.folder.truth(run.protocol.views.test[0]), run.frames[0])).shape
    return height * width


def _n_frames(run: MeasuredRun) -> int:
    """Frames of the truth and of all methods."""
    return len(run.frames) * len(run.protocol.views.test) * (1 + len(run.pictured))


def _n_poses(run: MeasuredRun) -> int:
    return sum(len(list(run.folder.path(key).glob("*.png"))) for key in ("truth", *run.pictured))
