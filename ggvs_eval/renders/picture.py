"""Rendered frames that are pictures on disk: RGB in PNG is linked as it is, everything else is decoded once, and it is said."""

import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.files.picture_header import PictureHeader, read_picture_header
from ggvs_eval.files.plain import LARGEST_PICTURE, check_plain, why_unread
from ggvs_eval.progress import counted
from ggvs_eval.run_folder import as_ranges, frame_path


def read_header(path: Path) -> PictureHeader:
    """Size and kind of a picture, without decoding it."""
    try:
        check_plain(path, LARGEST_PICTURE)
    except OSError as error:
        raise RenderError(f"{path}: wanted a picture, it cannot be read ({why_unread(error)}); restore it") from error
    try:
        return read_picture_header(path)
    except Exception as error:  # the parser raises whatever a damaged header makes it stumble over
        contents = "other bytes or a damaged header"
        raise RenderError(f"{path}: wanted a PNG or JPEG picture, got {contents}; render this frame again") from error


def size_fault(size: tuple[int, int], wanted: tuple[int, int]) -> str:
    """Describe a wrong (width, height) of a frame; empty where it is right.

    Examples:
        >>> size_fault((320, 120), (160, 120))
        '320 x 120 instead of 160 x 120: 2 pictures side by side? cut out the rendered one'
    """
    if size == wanted:
        return ""
    fault = f"{size[0]} x {size[1]} instead of {wanted[0]} x {wanted[1]}"
    for axis, lie in ((0, "side by side"), (1, "one above the other")):
        count, rest = divmod(size[axis], wanted[axis])
        if size[1 - axis] == wanted[1 - axis] and count > 1 and not rest:
            return f"{fault}: {count} pictures {lie}? cut out the rendered one"
    return fault


class PixelRemarks:
    """Notes on the pixels of a view's frames, gathered while these are read."""

    def __init__(self) -> None:
        self._black: list[int] = []
        self._grey: list[int] = []

    def add(self, number: int, image: Image8) -> None:
        """Look at the next frame, (H, W, 3)."""
        if not image.any():
            self._black.append(number)
        elif np.array_equal(image[..., 0], image[..., 1]) and np.array_equal(image[..., 1], image[..., 2]):
            self._grey.append(number)

    def notes(self) -> list[str]:
        """A line for each kind of remarkable frame; none where there are none."""
        black, grey = (f"{counted(len(some), 'frame')} ({as_ranges(some)})" for some in (self._black, self._grey))
        notes = [f"{black} all zero: did rendering fail? scored as it is"] if self._black else []
        return notes + ([f"{grey} grey: the same level is measured in all three channels"] if self._grey else [])


@dataclass(frozen=True)
class PictureView:
    """Frames of one view that are pictures, a `RenderedView`.

    Attributes:
        pictures: frame number -> file.
        is_temporary: whether the files are ours to move; else they are linked.
    """

    pictures: Mapping[int, Path]
    is_temporary: bool = False

    @property
    def numbers(self) -> tuple[int, ...]:
        """Frame numbers that there are, rising."""
        return tuple(sorted(self.pictures))

    def faults(self, size: tuple[int, int]) -> dict[int, str]:
        """Frames that are damaged, of another size, or not of 8 bits."""
        faults = {number: _fault(path, size) for number, path in sorted(self.pictures.items())}
        return {number: fault for number, fault in faults.items() if fault}

    def write(self, folder: Path, numbers: tuple[int, ...]) -> list[str]:
        """Link RGB in PNG under its frame numbers and decode the rest; says what was decoded, and what is black or grey."""
        folder.mkdir(parents=True, exist_ok=True)
        converted: dict[str, list[int]] = defaultdict(list)
        remarks = PixelRemarks()
        for number in numbers:
            source, target = self.pictures[number], frame_path(folder, number)
            header, image = read_header(source), read_image(source)
            remarks.add(number, image)
            if header.form == "JPEG":
                converted["of JPEG, decoded once to PNG: what it lost counts against the method"].append(number)
            for conversion in header._replace(colours=header.colours.replace("grey", "")).conversions:  # seen from its pixels
                converted[f"read {conversion}"].append(number)
            if header.form == "JPEG" or header.colours:
                write_image(target, image)
            elif self.is_temporary:
                source.replace(target)
            else:
                os.symlink(source.resolve(), target)
        notes = [f"{counted(len(frames), 'frame')} ({as_ranges(frames)}) {how}" for how, frames in converted.items()]
        return notes + remarks.notes()


def _fault(path: Path, size: tuple[int, int]) -> str:
    """Say why one picture cannot be used; empty where it can."""
    try:
        header = read_header(path)
    except RenderError:
        return "no picture that can be read"
    if header.size != size:
        return size_fault(header.size, size)
    return f"{header.bits} bits per channel instead of 8: convert them yourself" if header.bits > 8 else ""
