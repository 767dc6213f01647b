"""Rendered frames that are pictures on disk: PNG is linked as it is, JPEG is decoded once."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import PNG_SIGNATURE, picture_size, read_image, write_image
from ggvs_eval.files.plain import LARGEST_PICTURE, check_plain, why_unread
from ggvs_eval.run_folder import frame_path

JPEG_SIGNATURE = b"\xff\xd8\xff"
IHDR_END = 29
ALPHA_TYPES = (4, 6)


class Header(NamedTuple):
    """What the first bytes of a picture say; its name is not asked.

    Attributes:
        form: how it is coded.
        width: in pixels, turned as its EXIF tag says.
        height: likewise.
        fault: why its pixels would not be measured as they were written; empty where they would.
        has_alpha: whether it carries transparency, which is not measured.
    """

    form: Literal["PNG", "JPEG"]
    width: int
    height: int
    fault: str = ""
    has_alpha: bool = False


def read_header(path: Path) -> Header:
    """Size and kind of a picture, without decoding it.

    Raises:
        RenderError: neither PNG nor JPEG, or cut before its size.
    """
    try:
        check_plain(path, LARGEST_PICTURE)
        with path.open("rb") as file:
            start = file.read(IHDR_END)
    except OSError as error:
        raise RenderError(f"{path}: wanted a picture, it cannot be read ({why_unread(error)}); restore it") from error
    if start.startswith(PNG_SIGNATURE) and len(start) == IHDR_END:
        fault = "16 bits per channel instead of 8" if start[24] == 16 else ""
        return _header(path, "PNG", fault, start[25] in ALPHA_TYPES)
    if start.startswith(JPEG_SIGNATURE):
        return _header(path, "JPEG")
    raise RenderError(f"{path}: wanted a PNG or JPEG picture, got other bytes; render this frame again")


def _header(path: Path, form: Literal["PNG", "JPEG"], fault: str = "", has_alpha: bool = False) -> Header:
    """The header of a picture that begins as its form does."""
    try:
        return Header(form, *picture_size(path), fault, has_alpha)
    except Exception as error:  # the parser raises whatever a damaged header makes it stumble over
        raise RenderError(f"{path}: wanted a picture, got a damaged {form} header; render this frame again") from error


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
        found = {number: _fault(path, size) for number, path in sorted(self.pictures.items())}
        return {number: fault for number, fault in found.items() if fault}

    def write(self, folder: Path, numbers: tuple[int, ...]) -> list[str]:
        """Link the PNG files under their frame numbers and decode the JPEG files; says how many were decoded."""
        folder.mkdir(parents=True, exist_ok=True)
        headers = {number: read_header(self.pictures[number]) for number in numbers}
        for number, header in headers.items():
            source, target = self.pictures[number], frame_path(folder, number)
            if header.form == "JPEG":
                write_image(target, read_image(source))
            elif self.is_temporary:
                source.replace(target)
            else:
                os.symlink(source.resolve(), target)
        n_jpeg = sum(header.form == "JPEG" for header in headers.values())
        n_alpha = sum(header.has_alpha for header in headers.values())
        notes = [f"{n_jpeg} frames are JPEG, decoded once to PNG: what JPEG lost counts against the method"] if n_jpeg else []
        return notes + ([f"{n_alpha} frames have an alpha channel, which is left out"] if n_alpha else [])


def _fault(path: Path, size: tuple[int, int]) -> str:
    """Why one picture cannot be used; empty where it can."""
    try:
        header = read_header(path)
    except RenderError:
        return "no picture that can be read"
    if (header.width, header.height) != size:
        return f"{header.width} x {header.height} instead of {size[0]} x {size[1]}"
    return header.fault
