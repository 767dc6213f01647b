"""8-bit images, as they are stored and measured."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.files.picture_header import UPRIGHT, read_orientation
from ggvs_eval.files.plain import LARGEST_PICTURE, read_plain, why_unread

ResizeFilter = Literal["area", "lanczos", "bicubic", "bilinear"]
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# EXIF orientation -> what shows the stored pixels upright; the tag names the place of row 0 and
# column 0 in the scene.
TURNS: dict[int, Callable[[Image8], Image8]] = {
    2: lambda image: image[:, ::-1],
    3: lambda image: image[::-1, ::-1],
    4: lambda image: image[::-1],
    5: lambda image: image.swapaxes(0, 1),
    6: lambda image: image.swapaxes(0, 1)[:, ::-1],
    7: lambda image: image.swapaxes(0, 1)[::-1, ::-1],
    8: lambda image: image.swapaxes(0, 1)[::-1],
}
PNG_LEVEL = 1  # two thirds of the time that level 3 takes, for files 4 % larger


def quantise(image: NDArray[np.floating]) -> Image8:
    """Round an image in [0, 1] to 8 bit, as it will be saved; values outside are clipped.

    Examples:
        >>> quantise(np.array([[-0.1, 0.0, 0.5, 1.0]])).tolist()
        [[0, 0, 128, 255]]
    """
    return np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)


def round_levels(levels: NDArray[Any]) -> Image8:
    """Round levels on the scale 0..255 to 8 bit, as they will be saved.

    Values outside are clipped.
    """
    return np.rint(np.clip(levels, 0, 255)).astype(np.uint8)


def to_8_bit(image: NDArray[np.generic]) -> Image8:
    """Return an image as it will be saved: uint8 as it is, floats in [0, 1] rounded."""
    return (
        np.asarray(image, np.uint8)
        if image.dtype == np.uint8
        else quantise(np.asarray(image, np.float64))
    )


def mean_of_channels(image: NDArray[Any]) -> Array32:
    """Return the mean of the three channels, (h, w).

    NumPy's own mean over so short an axis takes ten times as long.
    """
    return np.asarray(
        (image[..., 0].astype(np.float32) + image[..., 1] + image[..., 2]) / np.float32(3),
        dtype=np.float32,
    )


def read_image(path: Path, as_stored: bool = False) -> Image8:
    """Read an 8-bit RGB image, (H, W, 3), turned as its EXIF tag says.

    Args:
        as_stored: return the pixels as stored, regardless of the tag.
    """
    encoded = read_encoded(path)
    image = decode_image(encoded, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        content = f"{path.stat().st_size} bytes that do not decode"
        raise CaptureError(
            f"{path}: wanted an image, got {content}; restore or render this frame again"
        )
    rgb = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    orientation = UPRIGHT if as_stored else read_orientation(encoded.tobytes())
    return rgb if orientation == UPRIGHT else np.ascontiguousarray(TURNS[orientation](rgb))


def read_encoded(path: Path) -> NDArray[np.uint8]:
    """Return the bytes of a picture's file."""
    try:
        encoded = np.frombuffer(read_plain(path, LARGEST_PICTURE), np.uint8)
    except OSError as error:
        raise CaptureError(
            f"{path}: wanted a picture, got {why_unread(error)}; restore or render this frame again"
        ) from error
    if not encoded.size:
        raise CaptureError(
            f"{path}: wanted a picture, got an empty file; restore or render this frame again"
        )
    return encoded


def decode_image(encoded: NDArray[np.uint8], flags: int) -> NDArray[np.generic] | None:
    """Return the image that a file's bytes hold, as ``cv2.imdecode`` gives it.

    None if they hold none.
    """
    if not encoded.size or _is_cut_png(encoded.tobytes()):
        return None
    try:
        return cv2.imdecode(encoded, flags)
    except cv2.error:  # a header that claims more pixels than OpenCV is willing to allocate
        return None


def _is_cut_png(content: bytes) -> bool:
    """Return whether a chunk of a PNG file continues past its end: OpenCV allocates what is
    claimed, 4 GB for 200 bytes.
    """
    at, kind = len(PNG_SIGNATURE), b""
    while content.startswith(PNG_SIGNATURE) and at + 8 <= len(content) and kind != b"IEND":
        kind = content[at + 4 : at + 8]
        at += 12 + int.from_bytes(content[at : at + 4], "big")
    return at > max(len(content), len(PNG_SIGNATURE))


def write_image(path: Path, image: Image8) -> None:
    """Write an 8-bit RGB image as PNG so that a killed process leaves either the whole file or
    none.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_image(Path(folder) / "0000.png", np.full((2, 3, 3), 7, np.uint8))
        ...     read_image(Path(folder) / "0000.png").shape
        (2, 3, 3)
    """
    _, encoded = cv2.imencode(
        ".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL]
    )
    write_bytes(path, encoded.tobytes())


def resize(image: Image8, width: int, height: int, resize_filter: ResizeFilter) -> Image8:
    """Resample an 8-bit image by a filter that is named in the protocol.

    Args:
        image: (H, W, 3) or (H, W), uint8.
        width: wanted width in pixels.
        height: wanted height in pixels.
        resize_filter: ``area`` (box average), or ``lanczos``, ``bicubic``, ``bilinear`` with the
            filter's support scaled to the reduction (antialiased, as Pillow does and as the DyNeRF
            loaders use it).

    Examples:
        >>> resize(np.array([[0, 10], [20, 30]], np.uint8), 1, 1, "area").tolist()
        [[15]]
    """
    if image.shape[1::-1] == (width, height):
        return image
    if resize_filter == "area":
        return np.asarray(
            cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8
        )
    from PIL import Image

    pillow_filter = Image.Resampling[resize_filter.upper()]
    return np.asarray(Image.fromarray(image).resize((width, height), pillow_filter))
