"""Folders that a run derives from others: frames, masks, path depth, the report; made anew when what they come from changes.

Captured frames are decoded, undistorted and resized once: every later step of a run reads these.
"""

import hashlib
import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, FrameSource, source_chain
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.atomic import sweep_files, write_text
from ggvs_eval.files.digest import digest_files
from ggvs_eval.files.images import ResizeFilter, read_image, resize, write_image
from ggvs_eval.jobs.engine import Workers, run_all
from ggvs_eval.run_folder import frame_path, read_json, write_json
from ggvs_eval.tasks.identity import code_of

DIGESTS = ".digests.json"  # hidden: it holds times of one machine, by which runs that are merged may differ
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
    """SHA-256 of what a folder holds: records by content, since they are written again as they were; others by size and time.

    Args:
        folder: links in it are not followed.
        without: names of folders that do not count, at any depth.
    """
    digest = hashlib.sha256()
    for place, names, files in os.walk(folder):
        names[:] = sorted(name for name in names if name not in without)
        for file in sorted(Path(place, name) for name in files if name != DIGESTS):
            about = file.stat()
            content = file.read_bytes() if file.suffix in RECORDS else f"{about.st_size} {about.st_mtime_ns}".encode()
            digest.update(f"{file.relative_to(folder)}\0".encode() + content)
    return digest.hexdigest()


@dataclass(frozen=True)
class MadeFiles:
    """Files of a folder that are made once, and again where they are lost, changed since, or made from something else.

    A record holds the digest of each file and its status (inode, size, times); while the status is the same, so is the content,
    since writing a file sets a time (ctime) that cannot be set back. Files with another status are hashed.

    Attributes:
        folder: holds the files and the record.
        made_from: all that they depend on, as JSON values.
    """

    folder: Path
    made_from: Any

    def missing(self, names: Iterable[str]) -> list[str]:
        """Wanted files that are not here as they were made from just this."""
        noted = self._noted()
        return [name for name in names if not _is_as_noted(self.folder / name, noted.get(name))]

    def missing_frames(self, numbers: Iterable[int]) -> list[int]:
        """Wanted frames, ``<frame>.png``, that are not here as they were made, in the order of time."""
        frames = {_frame_name(number): number for number in sorted(set(numbers))}
        return [frames[name] for name in self.missing(frames)]

    def are_whole(self) -> bool:
        """Return whether files have been noted, and each of them is as it was."""
        noted = self._noted()
        return bool(noted) and not self.missing(noted)

    def note(self, names: Iterable[str]) -> None:
        """Note files that have just been made, or that are as they were made."""
        noted = self._noted()
        files = {name: self.folder / name for name in names}
        changed = {name: _entry(file) for name, file in files.items() if noted.get(name, ())[:-1] != _status(file)}
        if changed:
            record = {"made_from": self.made_from, "files": noted | changed}
            write_text(self.folder / DIGESTS, json.dumps(record))  # indented it takes ten times as long, for each pose of a path

    def note_frames(self, numbers: Iterable[int]) -> None:
        """Note frames, see `note`."""
        self.note(map(_frame_name, numbers))

    def _noted(self) -> dict[str, list[Any]]:
        """Return file name -> status and digest, as far as made from the same."""
        record = _read_record(self.folder / DIGESTS)
        return record["files"] if record["made_from"] == json.loads(json.dumps(self.made_from)) else {}


def join_records(records: Iterable[Path], joined: Path) -> None:
    """Write one record for files that were put together from several folders, as far as all were made from the same."""
    noted = [record for record in map(_read_record, records) if record["files"]]
    alike = [record for record in noted if record["made_from"] == noted[0]["made_from"]]
    if alike:
        files = {name: entry for record in alike for name, entry in record["files"].items()}
        write_json(joined, {"made_from": alike[0]["made_from"], "files": files})


def _read_record(file: Path) -> dict[str, Any]:
    try:
        record = read_json(file)
        return {"made_from": record["made_from"], "files": dict(record["files"])}
    except (ResultsError, KeyError, TypeError, ValueError):  # none yet, or damaged
        return {"made_from": None, "files": {}}


def _frame_name(number: int) -> str:
    return frame_path(Path(), number).name


def _is_as_noted(file: Path, noted: list[Any] | None) -> bool:
    return noted is not None and file.is_file() and (noted[:-1] == _status(file) or noted[-1] == digest_files([file]))


def _entry(file: Path) -> list[Any]:
    return [*_status(file), digest_files([file])]  # the status first: what is written meanwhile shows in the next one


def _status(file: Path) -> list[int]:
    about = file.stat()
    return [about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns]


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
    """Return the capture with some cameras read from where `cache_frames` writes them, whether they are there yet or not."""
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
    """Return camera -> frames that `cache_frames` would write, in the order of time; arguments as of that."""
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
    """Return the poses whose true images `cache_path` would write; arguments as of that."""
    return _made_files(folder, images, size, resize_filter).missing_frames(range(images.n_frames))


def _camera_files(capture: Capture, name: str, root: Path) -> MadeFiles:
    return _made_files(root / name, capture.source(name), capture.camera(name).size, capture.resize_filter)


def _made_files(folder: Path, source: FrameSource, size: tuple[int, int], resize_filter: ResizeFilter) -> MadeFiles:
    code = code_of(*{type(part).__module__ for part in source_chain(source)})
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
