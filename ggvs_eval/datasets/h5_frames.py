"""Frames in the HDF5 files of the compressed D3DMV: read one at a time, from files that may be
damaged or hostile.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.digest import digest_files, digest_values
from ggvs_eval.files.names import listed
from ggvs_eval.files.plain import check_plain

# What a file claims is believed up to here; one frame of 16k x 5k, or one chunk of several smaller
# ones.
LARGEST_BLOCK_BYTES = 1 << 28
# Deflate, shuffle, checksum, LZF. Others would load code from a plug-in.
KNOWN_FILTERS = {1, 2, 3, 32000}
# What h5py raises on damaged files, as flipping bytes in thousands of them has shown.
H5_ERRORS = (
    OSError,
    RuntimeError,
    LookupError,
    ValueError,
    TypeError,
    ArithmeticError,
    MemoryError,
)


class _Stored(NamedTuple):
    """Layout of a dataset in the compressed files: axes in words, length of the last, and whether
    frames are an axis.
    """

    axes: str
    channels: int
    timed: bool


STORED = {
    "rgb": _Stored("(cameras, frames, H, W, 3)", 3, True),
    "fg_rgb": _Stored("(cameras, frames, H, W, 4)", 4, True),
    "bg_rgb": _Stored("(cameras, H, W, 3)", 3, False),
}


@dataclass(frozen=True)
class H5File:
    """A compressed file; it may be large, and is hashed once for all cameras and datasets in it."""

    path: Path

    @cached_property
    def digest(self) -> str:
        """Identifies the content; see `digest_files`."""
        return digest_files([self.path])


@dataclass(frozen=True)
class H5Frames:
    """The frames of one camera in a compressed file, a `FrameSource` that holds one frame and,
    between uses, no open file.

    Of ``fg_rgb`` the alpha is given, white where the foreground is; ``bg_rgb`` is a single frame.

    Attributes:
        dataset: ``rgb``, ``fg_rgb`` or ``bg_rgb``.
        camera: index of the camera in it.
    """

    file: H5File
    dataset: str
    camera: int

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.file.path

    @cached_property
    def _shape(self) -> tuple[int, ...]:
        with _opened(self.path, self.dataset) as stored:
            return tuple(stored.shape)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of cameras in the dataset, and of frames where these are one of its axes."""
        return self._shape[:-3]

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self._shape[1] if STORED[self.dataset].timed else 1

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self._shape[-2], self._shape[-3]

    @property
    def digest(self) -> str:
        """Identifies the file and the part of it that is read."""
        return digest_values(self.file.digest, self.dataset, str(self.camera))

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Read frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""
        if not 0 <= start <= stop <= self.n_frames:
            raise CaptureError(
                f"{self.path}: wanted frames {start}..{stop - 1} of {self.dataset}, it has "
                f"{self.n_frames}"
            )
        with _opened(self.path, self.dataset) as stored:
            for frame in range(start, stop):
                image = stored[(self.camera, frame) if STORED[self.dataset].timed else self.camera]
                yield np.repeat(image[..., 3:], 3, axis=-1) if image.shape[-1] == 4 else image


def h5_parts(path: Path) -> dict[str, list[H5Frames]]:
    """Return the frames of every camera, for each of the known datasets that a file holds.

    Raises:
        CaptureError: no file, no ``rgb``, or datasets of other types, shapes or lengths than their
            names promise.
    """
    with _opened_file(path) as file:
        names = [name for name in STORED if name == "rgb" or file.id.links.exists(name.encode())]
    h5_file = H5File(path)
    parts = {name: H5Frames(h5_file, name, 0) for name in names}
    rgb_counts = parts["rgb"].counts
    for name, part in parts.items():
        if part.counts != rgb_counts[: len(part.counts)]:
            remedy = "write both from the same frames"
            raise CaptureError(
                f"{path}: wanted {name} of (cameras, frames) {rgb_counts} of rgb, got "
                f"{part.counts}; {remedy}"
            )
    return {
        name: [H5Frames(h5_file, name, camera) for camera in range(rgb_counts[0])] for name in names
    }


@contextmanager
def _opened_file(path: Path) -> Iterator[Any]:
    """The open HDF5 file; what h5py raises while it is used becomes one line."""
    import h5py

    try:
        # Half-read chunks of several frames stay in the cache, so that nothing is unpacked twice.
        check_plain(path)
        with h5py.File(path, "r", locking=False, rdcc_nbytes=LARGEST_BLOCK_BYTES // 4) as file:
            yield file
    except H5_ERRORS as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise CaptureError(
            f"{path}: wanted an HDF5 file of D3DMV, got damage: {reason}; copy the file again"
        ) from error


@contextmanager
def _opened(path: Path, part: str) -> Iterator[Any]:
    """One dataset of the file, checked before anything of it is read."""
    import h5py

    with _opened_file(path) as file:
        if not file.id.links.exists(part.encode()):
            raise CaptureError(
                f"{path}: wanted a dataset {part!r}, there is {listed(file) or 'none'}; copy again"
            )
        # Links are looked at, not followed: they may lead into any other file.
        linked = file.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD
        stored = None if linked else file[part]
        problem = (
            _problem(stored, part, path) if isinstance(stored, h5py.Dataset) else "a link or group"
        )
        if problem:
            requirement = f"{part} to be uint8 {STORED[part].axes}, in this file"
            raise CaptureError(
                f"{path}: wanted {requirement}, got {problem}; convert the scene again"
            )
        yield stored


def _problem(stored: Any, part: str, path: Path) -> str | None:
    """Return the reason to refuse a dataset, by its header and index alone, or None if there is
    none.
    """
    shape, chunks = stored.shape, stored.chunks
    if stored.is_virtual or stored.external:
        return "data that are stored in another file"
    if (
        stored.dtype != np.uint8
        or shape is None
        or len(shape) != 4 + STORED[part].timed
        or shape[-1] != STORED[part].channels
    ):
        return f"{stored.dtype} {shape}"
    if (
        min(shape) < 1
        or math.prod(shape[-3:]) > LARGEST_BLOCK_BYTES
        or math.prod(chunks or (1,)) > LARGEST_BLOCK_BYTES
    ):
        return f"shape {shape} in chunks of {chunks}"
    if chunks is None:
        n_bytes = math.prod(shape)
        return f"{n_bytes} bytes in a smaller file" if n_bytes > path.stat().st_size else None
    layout = stored.id.get_create_plist()
    filters = {layout.get_filter(index)[0] for index in range(layout.get_nfilters())}
    if not filters <= KNOWN_FILTERS:
        return f"the unknown compression {min(filters - KNOWN_FILTERS)}"
    return _chunk_problem(stored)


def _chunk_problem(stored: Any) -> str | None:
    """Return the reason to refuse chunks: some missing, or so large that unpacking might never end.

    None if there is none.
    """
    sizes: list[int] = []
    stored.id.chunk_iter(lambda chunk: sizes.append(chunk.size))
    n_chunks = math.prod(
        -(-length // chunk) for length, chunk in zip(stored.shape, stored.chunks, strict=True)
    )
    if len(sizes) != n_chunks:
        return f"{len(sizes)} of {n_chunks} chunks, an unfinished file"
    largest = 2 * math.prod(stored.chunks) + 4096
    return (
        f"a chunk of {max(sizes)} packed bytes that holds no more than {largest // 2}"
        if max(sizes) > largest
        else None
    )
