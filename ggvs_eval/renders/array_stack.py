"""A stack of frames in a ``.npy`` file or in a member of an ``.npz`` archive: read frame by frame, nothing is unpickled."""

import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.datasets.array_file import HEADER_ERRORS, map_array
from ggvs_eval.errors import RenderError
from ggvs_eval.files.plain import check_plain

# Renderers overshoot a little; what lies farther out was never meant to be [0, 1].
OVERSHOOT = 0.1
ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError, ValueError)
SAFE_CODINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@dataclass(frozen=True)
class ArrayStack:
    """Frames (T, H, W, 3), uint8 or float in [0, 1], a `FrameStream`.

    Attributes:
        path: ``.npy`` or ``.npz``.
        member: name of the array in an ``.npz``; None for an ``.npy``.
    """

    path: Path
    member: str | None = None

    @property
    def name(self) -> str:
        """File, and member where there is one, for messages."""
        return f"{self.path}" if self.member is None else f"{self.path}[{self.member}]"

    @property
    def n_frames(self) -> int:
        """T."""
        return self._layout[0][0]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self._layout[0][2], self._layout[0][1]

    @property
    def conversions(self) -> dict[str, int]:
        """None: other channels and types are refused."""
        return {}

    def frames(self, start: int, stop: int) -> Iterator[NDArray[np.generic]]:
        """Frames start <= t < stop one by one, RGB (H, W, 3), uint8 or float64 in [0, 1] but for a little overshoot.

        Raises:
            RenderError: a file that ends early, NaN, or values that are not in [0, 1].
        """
        shape, dtype = self._layout
        stored = self._mapped(start, stop) if self.member is None else self._unzipped(start, stop, shape, dtype)
        for index, frame in enumerate(stored, start):
            yield self._checked(frame, index)

    @cached_property
    def _layout(self) -> tuple[tuple[int, ...], np.dtype[Any]]:
        """Shape and type as the header claims them, checked."""
        if self.member is None:
            array = self._map()
            shape, dtype = array.shape, array.dtype
        else:
            with self._open_member() as file:
                shape, dtype = self._read_header(file)
        if len(shape) != 4 or shape[3] != 3 or 0 in shape:
            raise RenderError(f"{self.name}: wanted an array (T, H, W, 3), got {_other_shape(shape)}")
        if dtype != np.uint8 and dtype.kind != "f":
            mend = "divide by 65535.0" if dtype == np.uint16 else "convert it"
            raise RenderError(f"{self.name}: wanted uint8, or float in [0, 1], got {dtype}; {mend}")
        return shape, dtype

    def _map(self) -> np.ndarray:
        try:
            return map_array(self.path)
        except ValueError as error:
            raise RenderError(f"{self.path}: wanted an array of numbers, got: {error}; save it with numpy.save") from error

    def _mapped(self, start: int, stop: int) -> Iterator[np.ndarray]:
        array = self._map()
        return (array[index] for index in range(start, stop))

    def _unzipped(self, start: int, stop: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Iterator[np.ndarray]:
        n_bytes = int(np.prod(shape[1:], dtype=np.int64)) * dtype.itemsize
        with self._open_member() as file:
            self._read_header(file)
            for index in range(stop):
                content = self._read(file, n_bytes, index)
                if index >= start:
                    yield np.frombuffer(content, dtype).reshape(shape[1:])

    def _read(self, file: IO[bytes], n_bytes: int, index: int) -> bytes:
        try:
            content = file.read(n_bytes)
        except ZIP_ERRORS as error:
            raise RenderError(f"{self.name}: damaged at frame {index} ({error}); save it again") from error
        if len(content) < n_bytes:
            raise RenderError(f"{self.name}: the file ends in frame {index}; save it again")
        return content

    def _open_member(self) -> IO[bytes]:
        try:
            check_plain(self.path)
            archive = zipfile.ZipFile(self.path)
            if archive.getinfo(f"{self.member}.npy").compress_type not in SAFE_CODINGS:
                raise NotImplementedError("a coding that numpy does not write")
            return archive.open(f"{self.member}.npy")
        except (*ZIP_ERRORS, KeyError) as error:
            raise RenderError(f"{self.name}: cannot be opened ({error}); save it with numpy.savez") from error

    def _read_header(self, file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
        readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        try:
            shape, is_fortran, dtype = readers[np.lib.format.read_magic(file)](file)
        except (*HEADER_ERRORS, *ZIP_ERRORS, KeyError) as error:
            reason = " ".join(str(error).split())[:120]
            raise RenderError(f"{self.name}: wanted an array of numbers, got: {reason}; save it again") from error
        if dtype.hasobject or is_fortran:
            contents = "Python objects, which are never unpickled" if dtype.hasobject else "Fortran order"
            raise RenderError(f"{self.name}: wanted numbers in C order, got {contents}; save numpy.ascontiguousarray(frames)")
        return shape, dtype

    def _checked(self, frame: np.ndarray, index: int) -> NDArray[np.generic]:
        if frame.dtype == np.uint8:
            return np.ascontiguousarray(frame)
        values = np.asarray(frame, dtype=np.float64)
        low, high = float(values.min()), float(values.max())
        if not (low >= -OVERSHOOT and high <= 1 + OVERSHOOT):  # NaN fails too
            raise RenderError(f"{self.name}: wanted floats in [0, 1], frame {index} has {low:g} to {high:g}; scale or clip them")
        return values


def _other_shape(shape: tuple[int, ...]) -> str:
    """Describe what an array of another shape seems to be, and what makes it (T, H, W, 3)."""
    if len(shape) == 3:
        return f"{shape}, which has no colours: save numpy.repeat(frames[..., None], 3, -1)"
    if len(shape) == 4 and shape[3] == 1:
        return f"{shape}, which is grey: save numpy.repeat(frames, 3, -1)"
    if len(shape) == 4 and shape[3] == 4:
        return f"{shape}, which has a fourth channel: save frames[..., :3]"
    return f"{shape}; transpose or split it"


def npz_members(path: Path) -> list[str]:
    """Names of the arrays in an ``.npz``."""
    try:
        check_plain(path)
        with zipfile.ZipFile(path) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
    except ZIP_ERRORS as error:
        raise RenderError(f"{path}: wanted an .npz archive, it cannot be opened ({error}); save it with numpy.savez") from error
