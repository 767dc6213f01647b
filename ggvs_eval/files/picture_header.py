"""Headers of pictures: coding, size, and the conversion to 8-bit RGB."""

from io import BytesIO
from pathlib import Path
from typing import Literal, NamedTuple

from ggvs_eval.files.plain import LARGEST_PICTURE, check_plain

EXIF_ORIENTATION, LYING = 0x0112, (5, 6, 7, 8)  # these are shown with width and height exchanged
UPRIGHT = 1
SEEN_THROUGH = (
    "without the alpha of transparent pixels: the colour beneath counts, composite it "
    "over the background to change that"
)
PNG_DEPTH_AT = 24
# A JPEG has its tags in a segment before its pixels, a PNG in a chunk anywhere.
EXIF_MARK, EXIF_WITHIN, EXIF_CHUNK = b"Exif\0", 1 << 20, b"eXIf"
COLOURS = {
    "1": "grey",
    "L": "grey",
    "LA": "grey",
    "I": "grey",
    "I;16": "grey",
    "P": "palette",
    "PA": "palette",
    "CMYK": "CMYK",
}


class PictureHeader(NamedTuple):
    """Header of a picture by its first bytes; its name is not asked.

    Attributes:
        width: in pixels, turned as its EXIF tag says.
        colours: ``grey``, ``palette`` or ``CMYK`` where its pixels are no RGB; else empty.
        orientation: its EXIF tag, 1 to 8; 1 is shown as it is stored.
        profile: name of its colour profile; empty if it has none, or that of sRGB.
    """

    form: Literal["PNG", "JPEG"]
    width: int
    height: int
    colours: str = ""
    bits: int = 8
    has_alpha: bool = False
    orientation: int = UPRIGHT
    profile: str = ""

    @property
    def stored_size(self) -> tuple[int, int]:
        """(width, height) in pixels, as stored."""
        return (self.height, self.width) if self.orientation in LYING else (self.width, self.height)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, as the picture is read."""
        return self.width, self.height

    @property
    def conversions(self) -> list[str]:
        """Changes by reading it as 8-bit RGB, in a few words each."""
        ignored = (
            [f"as if they were sRGB, though their colour profile is {self.profile}"]
            if self.profile
            else []
        )
        return [*conversions_to_rgb8(self.colours, self.bits, self.has_alpha), *ignored]


def conversions_to_rgb8(colours: str, bits: int, has_alpha: bool) -> list[str]:
    """List the changes by reading pixels as 8-bit RGB, arguments as of `PictureHeader`.

    Examples:
        >>> conversions_to_rgb8("grey", 16, False)
        ['grey, the same level in all three channels', 'cut from 16 to 8 bits']
    """
    how = {
        "grey": "grey, the same level in all three channels",
        "palette": "in the colours of a palette",
    }
    changes = [how.get(colours, f"converted from {colours}")] if colours else []
    changes += [f"cut from {bits} to 8 bits"] if bits > 8 else []
    return changes + (["without an alpha channel"] if has_alpha else [])


def read_picture_header(path: Path) -> PictureHeader:
    """Read the header of a PNG or JPEG picture; nothing is decoded.

    Raises:
        OSError: no regular file, or larger than a picture is.
        Exception: any, on a damaged header.
    """
    from PIL import Image

    check_plain(path, LARGEST_PICTURE)
    with Image.open(path, formats=("PNG", "JPEG")) as image:
        width, height = image.size
        orientation = _orientation(image.info.get("exif", b""))
        if orientation in LYING:
            width, height = height, width
        form: Literal["PNG", "JPEG"] = "PNG" if image.format == "PNG" else "JPEG"
        has_alpha = image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
        bits = _bits(path) if form == "PNG" else 8
        profile = _profile(image.info.get("icc_profile") or b"")
        return PictureHeader(
            form=form,
            width=width,
            height=height,
            colours=COLOURS.get(image.mode, ""),
            bits=bits,
            has_alpha=has_alpha,
            orientation=orientation,
            profile=profile,
        )


def transparent_share(path: Path) -> float:
    """Return the share of a picture's pixels that are not opaque.

    0 if it cannot be decoded, which the reader reports.
    """
    import numpy as np
    from PIL import Image

    try:
        with Image.open(path, formats=("PNG", "JPEG")) as image:
            return float((np.asarray(image.convert("RGBA").getchannel("A")) < 255).mean())
    except Exception:  # as below
        return 0.0


def read_orientation(encoded: bytes) -> int:
    """Return the EXIF orientation of a picture's bytes.

    1 if they say none, or nothing that makes sense.
    """
    from PIL import Image

    if EXIF_MARK not in encoded[:EXIF_WITHIN] and EXIF_CHUNK not in encoded:
        return UPRIGHT
    try:
        with Image.open(BytesIO(encoded), formats=("PNG", "JPEG")) as image:
            return _orientation(image.info.get("exif", b""))
    except Exception:  # parsers raise anything on a damaged header; the decoder reports it
        return UPRIGHT


def _orientation(exif: bytes) -> int:
    from PIL import Image

    tags = Image.Exif()
    try:
        tags.load(exif)
        orientation = int(tags.get(EXIF_ORIENTATION, UPRIGHT))
    except Exception:  # as above
        return UPRIGHT
    return orientation if UPRIGHT <= orientation <= LYING[-1] else UPRIGHT


def _profile(encoded: bytes) -> str:
    """The name of a colour profile; empty without one, of sRGB, and of one that cannot be read."""
    from PIL import ImageCms

    try:
        name = (
            ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(BytesIO(encoded))).strip()
            if encoded
            else ""
        )
    except Exception:  # as above
        return ""
    return "" if "srgb" in name.lower() else name[:80]


def _bits(path: Path) -> int:
    """Return the bits per sample of a PNG, which Pillow reports for grey ones only."""
    with path.open("rb") as file:
        return file.read(PNG_DEPTH_AT + 1)[PNG_DEPTH_AT]
