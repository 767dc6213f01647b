"""A video per method that the page carries: its test views one after the other, as a viewer would see them."""

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import read_image
from ggvs_eval.files.video import write_video
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.page.data_uri import shrink
from ggvs_eval.run_folder import frame_path

VIDEO_BYTES = 3_000_000
FRAMES_AT_MOST = 300
WIDTHS = (480, 320, 240, 160)
CRF = 26.0  # for looking at; x264's own default is 23
DEFAULT_FPS = 10.0


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
        run: a scored run.
        fps: frames per second of the capture; 0 where unknown, then `DEFAULT_FPS`.
        byte_budget: what all videos may take together, before base64; the narrowest width is taken where nothing fits.

    Reading:
        Long runs are cut: as many whole views as `FRAMES_AT_MOST` frames hold, at least the beginning of one.
    """
    if len(run.frames) < 2:
        return ()
    views = run.protocol.views.test[: max(1, FRAMES_AT_MOST // len(run.frames))]
    keys = ("truth", *run.pictured)
    for width in WIDTHS:
        videos = [_encode(run, key, views, width, fps or DEFAULT_FPS) for key in keys]
        if sum(len(video) for video, *_ in videos) <= byte_budget:
            break
    addresses = ["data:video/mp4;base64," + base64.b64encode(video).decode("ascii") for video, *_ in videos]
    return tuple(
        MethodVideo(run.name(key), views, width, height, address)
        for key, (_, width, height), address in zip(keys, videos, addresses, strict=True)
    )


def _encode(run: MeasuredRun, key: str, views: tuple[str, ...], width: int, fps: float) -> tuple[bytes, int, int]:
    """One video as bytes, its width and height."""
    folders = [run.frame_folders(view)[key] for view in views]
    first = next(_pictures(folders[:1], run.frames, width))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "video.mp4"
        write_video(file, _pictures(folders, run.frames, width), fps, CRF)
        return file.read_bytes(), first.shape[1], first.shape[0]


def _pictures(folders: list[Path], frames: range, width: int) -> Iterator[Image8]:
    """Frames of folder after folder, reduced, a last odd row or column cut off (4:2:0 wants even sizes)."""
    for folder in folders:
        for frame in frames[:FRAMES_AT_MOST]:
            image = shrink(read_image(frame_path(folder, frame)), width)
            yield image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
