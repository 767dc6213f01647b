"""Headers of pictures: coding, size, and what is lost or made up when one is read as 8-bit RGB."""

from pathlib import Path
from typing import Literal, NamedTuple

from ggvs_eval.files.plain import LARGEST_PICTURE, check_plain

EXIF_ORIENTATION, LYING = 0x0112, (5, 6, 7, 8)  # these are shown with width and height exchanged
PNG_DEPTH_AT = 24
COLOURS = {"1": "grey", "L": "grey", "LA": "grey", "I": "grey", "I;16": "grey", "P": "palette", "PA": "palette", "CMYK": "CMYK"}


class PictureHeader(NamedTuple):
    """Header of a picture by its first bytes; its name is not asked.

    Attributes:
        form: how it is coded.
        width: in pixels, turned as its EXIF tag says.
        height: likewise.
        colours: ``grey``, ``palette`` or ``CMYK`` where its pixels are no RGB; else empty.
        bits: per sample.
        has_alpha: whether it carries transparency.
    """

    form: Literal["PNG", "JPEG"]
    width: int
    height: int
    colours: str = ""
    bits: int = 8
    has_alpha: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, as the picture is read."""
        return self.width, self.height

    @property
    def conversions(self) -> list[str]:
        """Changes by reading it as 8-bit RGB, in a few words each."""
        return conversions_to_rgb8(self.colours, self.bits, self.has_alpha)


def conversions_to_rgb8(colours: str, bits: int, has_alpha: bool) -> list[str]:
    """List the changes by reading pixels as 8-bit RGB, arguments as of `PictureHeader`.

    Examples:
        >>> conversions_to_rgb8("grey", 16, False)
        ['grey, the same level in all three channels', 'cut from 16 to 8 bits']
    """
    how = {"grey": "grey, the same level in all three channels", "palette": "in the colours of a palette"}
    changes = [how.get(colours, f"converted from {colours}")] if colours else []
    changes += [f"cut from {bits} to 8 bits"] if bits > 8 else []
    return changes + (["without an alpha channel"] if has_alpha else [])


def read_picture_header(path: Path) -> PictureHeader:
    """Read the header of a PNG or JPEG picture; nothing is decoded.

    Raises:
        OSError: no regular file, or larger than a picture is.
        Exception: whatever a damaged header makes its parser stumble over.
    """
    from PIL import Image

    check_plain(path, LARGEST_PICTURE)
    with Image.open(path, formats=("PNG", "JPEG")) as image:
        width, height = image.size
        tags = image.getexif() if "exif" in image.info else {}  # asked without, Pillow decodes a PNG to look for them
        if tags.get(EXIF_ORIENTATION) in LYING:
            width, height = height, width
        form: Literal["PNG", "JPEG"] = "PNG" if image.format == "PNG" else "JPEG"
        has_alpha = image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
        return PictureHeader(form, width, height, COLOURS.get(image.mode, ""), _bits(path) if form == "PNG" else 8, has_alpha)


def _bits(path: Path) -> int:
    """Bits per sample of a PNG, which Pillow tells of grey ones alone."""
    with path.open("rb") as file:
        return file.read(PNG_DEPTH_AT + 1)[PNG_DEPTH_AT]
