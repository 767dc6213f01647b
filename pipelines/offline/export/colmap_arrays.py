"""COLMAP's files of depth and normal maps: ``width&height&channels&`` in ASCII, then float32, one channel after the other."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import DepthError
from ggvs_eval.files.atomic import write_bytes

HEADER = re.compile(rb"(\d{1,9})&(\d{1,9})&(\d{1,9})&")


def write_array(path: Path, array: NDArray[np.float32]) -> None:
    """Write a map whole or not at all.

    Args:
        path: the file; its folder is made.
        array: (H, W), or (H, W, C).
    """
    planes = array[None] if array.ndim == 2 else np.moveaxis(array, -1, 0)  # (C, H, W)
    channels, height, width = planes.shape
    write_bytes(path, f"{width}&{height}&{channels}&".encode() + np.ascontiguousarray(planes, "<f4").tobytes())


def read_array(path: Path) -> NDArray[np.float32]:
    """Read what `write_array` or COLMAP wrote, (H, W) where it has one channel, else (H, W, C).

    Raises:
        DepthError: absent, or not such a file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DepthError(f"{path}: wanted a map of COLMAP's, got: {error}; export the workspace again") from None
    header = HEADER.match(content)
    if header is None:
        raise DepthError(f"{path}: wanted a map that begins with width&height&channels&, got {content[:24]!r}; export it again")
    width, height, channels = (int(number) for number in header.groups())
    wanted, found = 4 * width * height * channels, len(content) - header.end()
    if wanted != found or not wanted:
        raise DepthError(
            f"{path}: wanted {width} x {height} x {channels} numbers in {wanted} bytes, got {found}; the file is cut short or "
            "damaged, export it again"
        )
    planes = np.frombuffer(content, "<f4", offset=header.end()).reshape(channels, height, width)
    return np.ascontiguousarray(planes[0] if channels == 1 else np.moveaxis(planes, 0, -1), np.float32)
