"""Raw videos of known lenses, written as pinhole videos or frames."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import FrameSource
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.assemble import common_count, common_rate
from ggvs_eval.datasets.camera_frames import CameraFrames, find_rig_frames
from ggvs_eval.datasets.undistort import UndistortedFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.atomic import atomic_folder
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.lens import Lens
from ggvs_eval.pipelines.offline.calibration.known_cameras import INTRINSICS, write_intrinsics
from ggvs_eval.pipelines.offline.calibration.lens_files import LensAndTarget, read_lenses
from ggvs_eval.progress import track


@dataclass(frozen=True)
class UndistortOptions:
    """Options of writing undistorted frames.

    Attributes:
        lossless: PNG folders instead of videos.
        crf: x264's rate factor of the videos; 8 loses less than resampling does.
    """

    lossless: bool = False
    crf: float = 8.0

    def __post_init__(self) -> None:
        """Refuse a rate factor that x264 does not know."""
        if not 0 <= self.crf <= 51:
            raise CaptureError(f"undistort: the rate factor must lie in 0..51, got {self.crf:g}")


@dataclass(frozen=True)
class Undistorted:
    """Record of the undistorted frames that were written.

    Attributes:
        path: the folder: ``CAM.mp4`` or ``images/CAM/``, and ``intrinsics.toml``.
        fps: frames per second; 0 where the capture is a single instant.
    """

    path: Path
    cameras: tuple[str, ...]
    n_frames: int
    fps: float


@dataclass(frozen=True, eq=False)
class _Stream:
    """The pinhole frames of one camera."""

    name: str
    frames: Callable[[], Iterator[Image8]]
    n_frames: int
    fps: float
    pinhole: Lens


def undistort_videos(source: Path, lens_file: Path | None, out: Path, options: UndistortOptions | None = None) -> Undistorted:
    """Write the frames of all cameras as a pinhole camera would have taken them, at their size and rate.

    Args:
        source: a folder of raw videos (or frames) with a lens file; without one, any capture, whose frames are written as
            `open_capture` gives them.
        lens_file: ``intri.yml``, ``calib_*.pkl`` or a TOML file; see `read_lenses`. None for a capture that knows its lenses.
        out: folder to write, absent or empty; it appears when it is whole.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise CaptureError(f"{out}: wanted a new or empty folder for undistorted frames, got one with content; choose another")
    streams = _of_capture(source) if lens_file is None else _of_files(source, lens_file)
    with atomic_folder(out) as unfinished:
        _write_all(unfinished, streams, options or UndistortOptions())
        write_intrinsics(unfinished / INTRINSICS, {stream.name: stream.pinhole for stream in streams})
    return Undistorted(out, tuple(stream.name for stream in streams), streams[0].n_frames, streams[0].fps)


def _of_capture(path: Path) -> list[_Stream]:
    capture = open_capture(path, measure_depth=False)
    streams = []
    for camera in capture.cameras:
        pinhole = Lens(camera.K, "opencv", (0.0,) * 4, *camera.size)
        streams.append(_Stream(camera.name, partial(capture.frames, camera.name), capture.n_frames, capture.fps, pinhole))
    return streams


def _of_files(folder: Path, lens_file: Path) -> list[_Stream]:
    files = find_rig_frames(folder)
    rate = common_rate(folder, files) if common_count(folder, files) > 1 else 0.0
    lenses = read_lenses(lens_file, {name: file.size for name, file in files.items()})
    return [_stream(name, file, lenses[name], rate) for name, file in files.items()]


def _stream(name: str, file: CameraFrames, lens_and_target: LensAndTarget, rate: float) -> _Stream:
    lens, count = lens_and_target.lens, file.n_frames
    frames: FrameSource = file if lens.is_pinhole else UndistortedFrames(file, lens, lens_and_target.K)
    pinhole = Lens(lens_and_target.K, "opencv", (0.0,) * 4, lens.width, lens.height)
    return _Stream(name, partial(frames.frames, 0, count), count, rate, pinhole)


def _write_all(folder: Path, streams: list[_Stream], options: UndistortOptions) -> None:
    """Cameras side by side: decoding, resampling and encoding all leave the interpreter free."""
    pool = ThreadPoolExecutor(default_workers())
    try:
        jobs = [pool.submit(_write, folder, stream, options) for stream in streams]
        for job in track(jobs, "undistorting", len(jobs)):
            job.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _write(folder: Path, stream: _Stream, options: UndistortOptions) -> None:
    if not options.lossless and stream.fps > 0:
        write_video(folder / f"{stream.name}.mp4", stream.frames(), stream.fps, options.crf)
        return
    for index, image in enumerate(stream.frames()):
        write_image(folder / "images" / stream.name / f"{index:06d}.png", image)
