"""Folders that a run derives from others: frames, masks, path depth, the report.

Made anew when what they come from changes.

Captured frames are decoded, undistorted and resized once: every later step of a run reads these.
"""

import hashlib
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, FrameSource, source_chain
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.atomic import sweep_files
from ggvs_eval.files.images import ResizeFilter, read_image, resize, write_image
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.run_folder import frame_names, frame_numbers, frame_path
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.run_tasks import make_files
from ggvs_eval.tasks.task import FileTask

RECORDS = (".json", ".toml", ".parquet", ".csv")


def seen_from(target: Camera, keys: Mapping[str, str]) -> dict[str, Any]:
    """Return a target and its sources' depth, as a note says them.

    Args:
        keys: source camera -> key of its depth in the depth store.
    """
    return {
        "target": target.to_json(),
        "depth": dict(keys),
    }


def digest_folder(folder: Path, without: Collection[str] = ()) -> str:
    """SHA-256 of what a folder holds: records by content, since they are written again as they
    were; others by size and time.

    Args:
        folder: links in it are not followed.
        without: names of folders that do not count, at any depth.
    """
    digest = hashlib.sha256()
    for place, names, files in os.walk(folder):
        names[:] = sorted(name for name in names if name not in without)
        for file in sorted(Path(place, name) for name in files):
            about = file.stat()
            content = (
                file.read_bytes()
                if file.suffix in RECORDS
                else f"{about.st_size} {about.st_mtime_ns}".encode()
            )
            digest.update(f"{file.relative_to(folder)}\0".encode() + content)
    return digest.hexdigest()


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
    """Return the capture with some cameras read from where `cache_frames` writes them, whether they
    are there yet or not.
    """
    sources: list[FrameSource] = [
        CachedFrames(root / name, capture.n_frames, source.digest) if name in names else source
        for name, source in zip(capture.camera_names, capture.sources, strict=True)
    ]
    return replace(capture, sources=tuple(sources))


def cache_frames(
    capture: Capture, numbers: Mapping[str, Sequence[int]], root: Path, workers: Workers
) -> Capture:
    """Write frames of some cameras, at the size of these cameras, that are not there as they were
    written.

    Cameras are decoded side by side, each video once and as a stream.

    Args:
        numbers: camera -> frames, in any order.
        root: folder to write ``<camera>/<frame>.png`` into.

    Returns:
        The capture with these cameras read from there.
    """
    make_files(frame_tasks(capture, numbers, root), workers, "frames per camera")
    return cached_capture(capture, numbers, root)


def frame_tasks(
    capture: Capture, numbers: Mapping[str, Sequence[int]], root: Path
) -> list[FileTask]:
    """Return what writes the frames of each camera; arguments as of `cache_frames`."""
    return [
        _pictures(
            name=f"frames of {name}",
            folder=root / name,
            source=capture.source(name),
            size=capture.camera(name).size,
            resize_filter=capture.resize_filter,
            numbers=frames,
            make=partial(_write_frames, capture, name, root / name),
        )
        for name, frames in numbers.items()
    ]


def path_task(
    images: ImageFrames, size: tuple[int, int], resize_filter: ResizeFilter, folder: Path
) -> FileTask:
    """Return what writes the true images along a camera path.

    Args:
        size: (width, height) to write them at.
        folder: where ``<pose>.png`` goes.
    """
    return _pictures(
        name="true images of the path",
        folder=folder,
        source=images,
        size=size,
        resize_filter=resize_filter,
        numbers=range(images.n_frames),
        make=partial(_write_poses, images, size, resize_filter, folder),
    )


def _pictures(
    *,
    name: str,
    folder: Path,
    source: FrameSource,
    size: tuple[int, int],
    resize_filter: ResizeFilter,
    numbers: Iterable[int],
    make: Callable[[tuple[str, ...]], object],
) -> FileTask:
    code = code_of(*{type(part).__module__ for part in source_chain(source)})
    return FileTask(
        name=name,
        folder=folder,
        inputs={"frames": source.digest, "size": list(size), "resize": resize_filter, "code": code},
        files=frame_names(numbers),
        make=make,
        kind="truth",
    )


def _write_frames(capture: Capture, name: str, folder: Path, files: tuple[str, ...]) -> None:
    """Decode one camera from its first missing frame to its last; runs in a worker."""
    sweep_files(folder)
    frames = frame_numbers(files)
    start = frames[0]
    for index, image in enumerate(capture.frames(name, start, frames[-1] + 1), start):
        if index in frames:
            write_image(frame_path(folder, index), image)


def _write_poses(
    images: ImageFrames,
    size: tuple[int, int],
    resize_filter: ResizeFilter,
    folder: Path,
    files: tuple[str, ...],
) -> None:
    for pose in frame_numbers(files):
        (image,) = images.frames(pose, pose + 1)
        write_image(frame_path(folder, pose), resize(image, *size, resize_filter))
