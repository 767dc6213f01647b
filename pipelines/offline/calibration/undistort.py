"""Raw videos of known lenses, written as pinhole videos or frames.

Lenses come from the files that multi-camera data sets distribute with them.
"""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import pinhole_K
from ggvs_eval.capture import FrameSource
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.calibration_file import find_calibration_files
from ggvs_eval.datasets.calibration_readers import FileCamera
from ggvs_eval.datasets.camera_frames import find_rig_frames
from ggvs_eval.datasets.easymocap import PIXEL_CENTRE
from ggvs_eval.datasets.entries import plain_numbers
from ggvs_eval.datasets.instants import align_instants
from ggvs_eval.datasets.undistort import UndistortedFrames
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files import pickle_reader
from ggvs_eval.files.atomic import atomic_folder
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.lens import Lens
from ggvs_eval.pipelines.offline.calibration.known_cameras import (
    INTRINSICS,
    fit_known,
    read_known,
    write_intrinsics,
)
from ggvs_eval.progress import track
from ggvs_eval.side_process import SideProcess, SideProcessError

KINDS = (
    "intri.yml (EasyMocap), calib_*.pkl (D3DMV), .qca.txt (Qualisys), OpenCV's YAML or a .toml "
    "file with cameras"
)
LARGEST_PICKLE_BYTES, PICKLE_TIMEOUT_S = 1 << 20, 20
_PICKLES = SideProcess(Path(pickle_reader.__file__))
Size = tuple[int, int]


@dataclass(frozen=True, eq=False)
class LensAndTarget:
    """A lens and the pinhole image it is undistorted to.

    Attributes:
        lens: at the size of the frames.
        K: intrinsics of the pinhole image, at the same size.
    """

    lens: Lens
    K: Array


def read_lenses(path: Path, sizes: Mapping[str, Size]) -> dict[str, LensAndTarget]:
    """Return the lens of each camera, by name.

    Args:
        path: ``intri.yml``, ``calib_*.pkl``, or another file that `read_known` reads.
        sizes: (width, height) of each camera's frames, in the order of names.

    Raises:
        CaptureError: another kind of file, a damaged one, or one that does not fit the cameras.

    Reading:
        EasyMocap: the pinhole image keeps the lens's K, as ENeRF undistorts. D3DMV: 90 degrees wide
        (f = W / 2) with the principal point in the middle of the image, as its authors undistort;
        the list follows the order of names. Others: the lens's K, zoomed just so far that no pixel
        is blank. OpenCV's principal points are moved by half a pixel to this package's centres.
    """
    is_known = bool(find_calibration_files(path))
    if path.suffix.lower() in (".pkl", ".pickle"):
        return _from_d3dmv(path, sizes)
    if path.suffix.lower() != ".toml" and not is_known:
        raise CaptureError(
            f"{path}: wanted {KINDS}, got a file called {path.name}; rename it if it is one of "
            f"these"
        )
    lenses = {
        name: camera.lens
        for name, camera in fit_known(path, read_known(path, sizes), sizes).items()
    }
    try:
        is_kept = bool(find_calibration_files(path, "easymocap"))
        return {
            name: LensAndTarget(lens, lens.K if is_kept else lens.undistorted_K())
            for name, lens in lenses.items()
        }
    except CameraError as error:
        raise CaptureError(f"{path}: {error}") from error


def _from_d3dmv(path: Path, sizes: Mapping[str, Size]) -> dict[str, LensAndTarget]:
    entries = read_pickle(path)
    if not isinstance(entries, list) or len(entries) != len(sizes):
        content = f"{len(entries)} entries" if isinstance(entries, list) else "no list"
        raise CaptureError(
            f"{path}: wanted one entry for each of the {len(sizes)} cameras, got {content}; "
            f"restore all videos"
        )
    found_lenses = {}
    for entry, (name, (width, height)) in zip(entries, sizes.items(), strict=True):
        K, coefficients = (
            _numbers(path, name, entry, "K", 9).reshape(3, 3),
            _numbers(path, name, entry, "D", 4),
        )
        K[:2, 2] += PIXEL_CENTRE
        camera = FileCamera(
            name=name,
            K=K,
            model="fisheye",
            coefficients=tuple(map(float, coefficients)),
            size=None,
            world_to_camera=None,
        )
        try:
            lens = camera.lens((width, height))
        except CameraError as error:
            raise CaptureError(f"{path}: {name}: {error}") from error
        target = pinhole_K(width / 2, width / 2, width / 2, height / 2)
        found_lenses[name] = LensAndTarget(lens, target)
    return found_lenses


def read_pickle(path: Path) -> Any:
    """Read a ``calib_*.pkl``; nothing in it is run."""
    size = path.stat().st_size if path.is_file() else -1
    if not 0 < size <= LARGEST_PICKLE_BYTES:
        content = "no such file" if size < 0 else f"{size} bytes"
        raise CaptureError(
            f"{path}: wanted a pickled calibration below {LARGEST_PICKLE_BYTES >> 20} MiB, got "
            f"{content}; restore it"
        )
    try:
        return _PICKLES.ask(path, PICKLE_TIMEOUT_S)
    except (SideProcessError, TimeoutError) as error:
        raise CaptureError(
            f"{path}: wanted a pickle of plain numbers and arrays, got: {error}; nothing was run"
        ) from error


def _numbers(path: Path, name: str, entry: Any, key: str, count: int) -> Array:
    values = plain_numbers(entry.get(key) if isinstance(entry, dict) else None)
    if values.size != count or not np.isfinite(values).all():
        raise CaptureError(
            f"{path}: {name}: wanted {count} finite numbers {key}, got shape {values.shape}; "
            f"restore the file"
        )
    return values.ravel()


@dataclass(frozen=True)
class UndistortOptions:
    """Options of writing undistorted frames.

    Attributes:
        lossless: write PNG folders instead of videos.
        crf: x264 rate factor of the videos, 0..51; at 8 the loss is below that of resampling.
    """

    lossless: bool = False
    crf: float = 8.0

    def __post_init__(self) -> None:
        """Refuse a rate factor that x264 does not know."""
        if not 0 <= self.crf <= 51:
            raise CaptureError(f"undistort: the rate factor must be in 0..51, got {self.crf:g}")


@dataclass(frozen=True)
class Undistorted:
    """Record of the undistorted frames that were written.

    Attributes:
        path: the folder: ``CAM.mp4`` or ``images/CAM/``, and ``intrinsics.toml``.
        fps: frames per second; 0 if the capture is a single instant.
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


def undistort_videos(
    source: Path, lens_file: Path | None, out: Path, options: UndistortOptions | None = None
) -> Undistorted:
    """Write the frames of all cameras as a pinhole camera would have taken them, at their size and
    rate.

    Args:
        source: a folder of raw videos (or frames) with a lens file; without one, any capture, whose
            frames are written as `open_capture` gives them.
        lens_file: ``intri.yml``, ``calib_*.pkl`` or a TOML file; see `read_lenses`. None for a
            capture that knows its lenses.
        out: folder to write, absent or empty; it appears when it is whole.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise CaptureError(
            f"{out}: wanted a new or empty folder for undistorted frames, got one with content; "
            f"choose another"
        )
    streams = _of_capture(source) if lens_file is None else _of_files(source, lens_file)
    with atomic_folder(out) as unfinished:
        _write_all(unfinished, streams, options or UndistortOptions())
        write_intrinsics(
            unfinished / INTRINSICS, {stream.name: stream.pinhole for stream in streams}
        )
    return Undistorted(
        path=out,
        cameras=tuple(stream.name for stream in streams),
        n_frames=streams[0].n_frames,
        fps=streams[0].fps,
    )


def _of_capture(path: Path) -> list[_Stream]:
    capture = open_capture(path, measure_depth=False)
    streams = []
    for camera in capture.cameras:
        pinhole = Lens(camera.K, "opencv", (0.0,) * 4, *camera.size)
        streams.append(
            _Stream(
                name=camera.name,
                frames=partial(capture.frames, camera.name),
                n_frames=capture.n_frames,
                fps=capture.fps,
                pinhole=pinhole,
            )
        )
    return streams


def _of_files(folder: Path, lens_file: Path) -> list[_Stream]:
    files = find_rig_frames(folder)
    aligned = align_instants(folder, files)
    lenses = read_lenses(lens_file, {name: file.size for name, file in files.items()})
    return [
        _stream(name, source, lenses[name], aligned.fps) for name, source in aligned.sources.items()
    ]


def _stream(name: str, file: FrameSource, lens_and_target: LensAndTarget, rate: float) -> _Stream:
    lens, count = lens_and_target.lens, file.n_frames
    frames: FrameSource = (
        file if lens.is_pinhole else UndistortedFrames(file, lens, lens_and_target.K)
    )
    pinhole = Lens(
        K=lens_and_target.K,
        model="opencv",
        coefficients=(0.0,) * 4,
        width=lens.width,
        height=lens.height,
    )
    return _Stream(
        name=name,
        frames=partial(frames.frames, 0, count),
        n_frames=count,
        fps=rate,
        pinhole=pinhole,
    )


def _write_all(folder: Path, streams: list[_Stream], options: UndistortOptions) -> None:
    """Cameras side by side: decoding, resampling and encoding all leave the interpreter free."""
    pool = ThreadPoolExecutor(usable_cpus())
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
