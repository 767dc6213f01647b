"""Frames that are a part of the pictures a calibration was made for, and ``crop.toml``, which says which part."""

from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.datasets.frames import has_shape
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.toml_tables import build_table, read_toml
from ggvs_eval.lens import Lens

CROP_FILE = "crop.toml"
Size = tuple[int, int]


@dataclass(frozen=True)
class Crop:
    """Offset of the frames in the calibrated picture; the whole file.

    Attributes:
        left: column of the calibrated picture that the first column of the frames shows.
        top: row that the first row shows.
    """

    left: int
    top: int


def given_crop(folder: Path) -> Crop | None:
    """Read ``crop.toml`` in a capture's folder; None without that file."""
    file = folder / CROP_FILE
    return build_table(Crop, read_toml(file, CaptureError), str(file), "", CaptureError) if file.exists() else None


def write_crop(folder: Path, crop: Crop) -> Path:
    """Write a file that `given_crop` reads back, and return it."""
    file = folder / CROP_FILE
    file.write_text(f"left = {crop.left}\ntop = {crop.top}\n", encoding="utf-8")
    return file


def crop_lens(name: str, lens: Lens, frames: Size, crop: Crop | None) -> Lens:
    """The lens of a camera's frames; of pictures that are whole, or only scaled, the lens as it is.

    Args:
        frames: (width, height) of the frames, pixels; the crop is of pixels of the calibrated size.
        crop: where they begin in the calibrated picture; None where that is not given.
    """
    if crop is None or has_shape(frames, (lens.width, lens.height)):
        return lens
    right, bottom = crop.left + frames[0], crop.top + frames[1]
    if min(crop.left, crop.top) < 0 or right > lens.width or bottom > lens.height:
        raise CameraError(
            f"wanted a crop within the {lens.width} x {lens.height} that {name} is calibrated for, got frames of {frames[0]} x "
            f"{frames[1]} from {crop.left} {crop.top}; correct it"
        )
    return lens.cropped(crop.left, crop.top, *frames)


def describe_crop(frames: Size, calibrated: Size, path: Path) -> str:
    """Explain frames of another shape than their calibration, and what to do; for the end of a message.

    Examples:
        >>> describe_crop((1080, 1920), (1088, 1920), Path("rig"))[:25]
        '8 columns of it are missi'
    """
    columns, rows = calibrated[0] - frames[0], calibrated[1] - frames[1]
    if min(columns, rows) < 0:
        return "give the frames this calibration was made for, scaled but not cropped"
    counts = [f"{count} {noun}" for count, noun in ((columns, "columns"), (rows, "rows")) if count]
    centred = f"{columns // 2} {rows // 2}"
    return (
        f"{' and '.join(counts)} of it are missing. If they were cut off, say which column and row the frames begin with: "
        f"'ggvs-eval check {path} --crop 0 0' where they are cut at the right and the bottom, as codecs do, {centred} where on "
        "all sides ('crop' in capture.toml); if the frames were scaled unevenly, give those that were not"
    )
