"""Captured frames, decoded, undistorted and resized once: every later step of a run reads these."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import Capture, FrameSource, source_chain
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.atomic import sweep_files
from ggvs_eval.files.images import ResizeFilter, read_image, resize, write_image
from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.jobs.run_all import run_all
from ggvs_eval.pipelines.run.derived_files import MadeFiles
from ggvs_eval.run_folder import frame_path


@dataclass(frozen=True)
class CachedFrames:
    """Some frames of one camera in a run folder, a `FrameSource`.

    Attributes:
        folder: holds ``<frame>.png``.
        n_frames: frames of the camera in the capture, whether they are here or not.
        digest: of the frames in the capture.
    """

    folder: Path
    n_frames: int
    digest: str

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Read frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""
        for index in range(start, stop):
            yield read_image(frame_path(self.folder, index))


def cached_capture(capture: Capture, names: Collection[str], root: Path) -> Capture:
    """The capture with some cameras read from where `cache_frames` writes them, whether they are there yet or not."""
    sources: list[FrameSource] = [
        CachedFrames(root / name, capture.n_frames, source.digest) if name in names else source
        for name, source in zip(capture.camera_names, capture.sources, strict=True)
    ]
    return replace(capture, sources=tuple(sources))


def cache_frames(capture: Capture, numbers: Mapping[str, Sequence[int]], root: Path, workers: Workers) -> Capture:
    """Write frames of some cameras, at the size of these cameras, that are not there as they were written.

    Cameras are decoded side by side, each video once and as a stream.

    Args:
        numbers: camera -> frames, in any order.
        root: folder to write ``<camera>/<frame>.png`` into.

    Returns:
        The capture with these cameras read from there.
    """
    absent = frames_left(capture, numbers, root)
    run_all(partial(_write, capture, root), [each for each in absent.items() if each[1]], workers, "frames per camera")
    for name in numbers:
        if not absent[name]:
            _camera_files(capture, name, root).note_frames(numbers[name])
    return cached_capture(capture, numbers, root)


def frames_left(capture: Capture, numbers: Mapping[str, Sequence[int]], root: Path) -> dict[str, list[int]]:
    """Camera -> frames that `cache_frames` would write, in the order of time; arguments as of that."""
    return {name: _camera_files(capture, name, root).missing_frames(frames) for name, frames in numbers.items()}


def cache_path(images: ImageFrames, size: tuple[int, int], resize_filter: ResizeFilter, folder: Path) -> None:
    """Write the true images along a camera path that are not there as they were written.

    Args:
        size: (width, height) to write them at.
        folder: where ``<pose>.png`` goes.
    """
    if path_left(images, size, resize_filter, folder):
        for pose, image in enumerate(images.frames(0, images.n_frames)):
            write_image(frame_path(folder, pose), resize(image, *size, resize_filter))
    _made_files(folder, images, size, resize_filter).note_frames(range(images.n_frames))


def path_left(images: ImageFrames, size: tuple[int, int], resize_filter: ResizeFilter, folder: Path) -> list[int]:
    """Poses whose true images `cache_path` would write; arguments as of that."""
    return _made_files(folder, images, size, resize_filter).missing_frames(range(images.n_frames))


def _camera_files(capture: Capture, name: str, root: Path) -> MadeFiles:
    return _made_files(root / name, capture.source(name), capture.camera(name).size, capture.resize_filter)


def _made_files(folder: Path, source: FrameSource, size: tuple[int, int], resize_filter: ResizeFilter) -> MadeFiles:
    code = code_identity(*{type(each).__module__ for each in source_chain(source)}, resize.__module__)
    return MadeFiles(folder, {"frames": source.digest, "size": size, "resize": resize_filter, "code": code})


def _write(capture: Capture, root: Path, camera: tuple[str, Sequence[int]]) -> None:
    """Decode one camera from its first missing frame to its last; runs in a worker."""
    name, frames = camera
    folder, start, wanted = root / name, frames[0], set(frames)
    sweep_files(folder)
    for index, image in enumerate(capture.frames(name, start, frames[-1] + 1), start):
        if index in wanted:
            write_image(frame_path(folder, index), image)
    _camera_files(capture, name, root).note_frames(frames)
