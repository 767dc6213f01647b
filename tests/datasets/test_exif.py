"""Pictures that a tag turns: one reader decides for captures, calibration and the programs that
pictures are handed to.
"""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

from ggvs_eval.arrays import Image8
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.images import read_image
from ggvs_eval.files.picture_header import read_picture_header
from ggvs_eval.pipelines.offline.calibration.calibrate import link_frames, write_instant
from helpers.captures import (
    HEIGHT,
    NAMES,
    WIDTH,
    make_rig,
    refusal,
    write_colmap_model,
    write_poses,
)
from helpers.fuzz import CAPTURES
from helpers.small_layouts import camera_toml, transforms

ORIENTATION = 0x0112


def pattern(camera: int) -> Image8:
    """A picture whose corners all differ."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    image = np.stack([4 * rows, 3 * columns, np.full_like(rows, 30 + 20 * camera)], axis=-1)
    return image.astype(np.uint8)


def save(path: Path, stored: Image8, orientation: int, ending: bytes = b"") -> None:
    """A picture with this tag, in the format that its name says."""
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(stored).save(
        path, exif=exif, **({} if path.suffix == ".png" else {"quality": 98, "subsampling": 0})
    )
    path.write_bytes(path.read_bytes() + ending)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("orientation", range(9))
def test_all_orientations_are_turned_as_pillow_turns_them(orientation, suffix, tmp_path):
    """The eight of the standard, and one that is none; the header promises the size that is
    read.
    """
    file = tmp_path / f"a{suffix}"
    save(file, pattern(0), orientation)
    with Image.open(file) as opened:
        stored, shown = (
            np.asarray(opened.convert("RGB")),
            np.asarray(ImageOps.exif_transpose(opened).convert("RGB")),
        )

    assert np.abs(read_image(file).astype(int) - shown).max() <= 2  # two decoders of JPEG
    assert np.abs(read_image(file, as_stored=True).astype(int) - stored).max() <= 2
    assert read_picture_header(file).size == shown.shape[1::-1]
    assert read_picture_header(file).stored_size == stored.shape[1::-1]


def test_a_damaged_tag_turns_nothing(tmp_path):
    """The picture is read as it is stored, by pixels and by header."""
    save(tmp_path / "a.jpg", pattern(0), 6)
    content = (tmp_path / "a.jpg").read_bytes()
    at = content.index(b"Exif\0\0") + 6
    (tmp_path / "a.jpg").write_bytes(content[:at] + b"XX" + content[at + 2 :])

    assert (
        read_picture_header(tmp_path / "a.jpg").size
        == (WIDTH, HEIGHT)
        == read_image(tmp_path / "a.jpg").shape[1::-1]
    )


def colmap_rig(folder: Path) -> str:
    write_colmap_model(folder / "sparse" / "0", [f"{name}.jpg" for name in NAMES])
    return "images/{}.jpg"


def distorted_rig(folder: Path) -> str:
    write_colmap_model(
        folder / "sparse" / "0", [f"{name}.jpg" for name in NAMES], "SIMPLE_RADIAL", "0"
    )
    return "images/{}.jpg"


def nerfstudio_rig(folder: Path) -> str:
    (folder / "transforms.json").write_text(json.dumps(transforms()).replace(".png", ".jpg"))
    return "images/{}.jpg"


def dynerf_rig(folder: Path) -> str:
    write_poses(folder, make_rig())
    return "frames/{}/0000.jpg"


def own_rig(folder: Path) -> str:
    (folder / "capture.toml").write_text(
        "".join(camera_toml(camera, f"{camera.name}.jpg") for camera in make_rig())
    )
    return "{}.jpg"


RIGS: dict[str, Callable[[Path], str]] = {
    each.__name__: each for each in (colmap_rig, distorted_rig, nerfstudio_rig, dynerf_rig, own_rig)
}


def write_rig(
    folder: Path, rig: str, orientation: int, stored: Callable[[Image8], Image8] = np.asarray
) -> Path:
    folder.mkdir()
    place = RIGS[rig](folder)
    for index, name in enumerate(NAMES):
        save(folder / place.format(name), np.ascontiguousarray(stored(pattern(index))), orientation)
    return folder


@pytest.mark.parametrize(("rig", "orientation"), list(zip(RIGS, (5, 6, 7, 8, 6), strict=True)))
def test_a_calibration_of_stored_pixels_gets_stored_pixels(rig, orientation, tmp_path):
    """A model that was made outside knows of no tag: its size says so, and a note."""
    capture = open_capture(write_rig(tmp_path / "room", rig, orientation))

    for index, (camera, given) in enumerate(zip(capture.cameras, make_rig(), strict=True)):
        assert camera.size == (WIDTH, HEIGHT)
        assert camera.centre == pytest.approx(given.centre, abs=1e-7)
        assert np.abs(capture.frame(camera.name, 0).astype(int) - pattern(index)).mean() < 1.5
    assert any(
        f"EXIF orientation {orientation} " in note and "stored" in note for note in capture.notes
    )


@pytest.mark.parametrize("rig", RIGS)
def test_a_calibration_of_upright_pictures_gets_these(rig, tmp_path):
    """The same tag beside a calibration of the size that is shown."""
    folder = write_rig(tmp_path / "room", rig, 6, lambda image: np.rot90(image))

    capture = open_capture(folder)

    for index, camera in enumerate(capture.cameras):
        assert camera.size == (WIDTH, HEIGHT)
        assert np.abs(capture.frame(camera.name, 0).astype(int) - pattern(index)).mean() < 1.5


@pytest.mark.parametrize(("rig", "orientation"), list(zip(RIGS, (2, 3, 4, 3, 2), strict=True)))
def test_a_turn_that_no_size_shows_is_noted(rig, orientation, tmp_path):
    """Whether the poses are those of the stored pixels only the pictures can tell: the note names
    EXIF and `check`.
    """
    capture = open_capture(write_rig(tmp_path / "room", rig, orientation))

    note = next(note for note in capture.notes if "EXIF" in note)
    assert f"all cameras with the EXIF orientation {orientation} " in note
    assert "check" in note


def test_pictures_of_neither_shape_are_refused_with_the_tag(tmp_path):
    """Cropped pictures fit neither way."""
    folder = write_rig(tmp_path / "room", "colmap_rig", 6, lambda image: image[:, :40])

    assert (
        "frames of 48 x 40, turned as their EXIF orientation 6 says, have another shape"
        in refusal(folder)
    )


def test_stored_pixels_are_other_content(tmp_path):
    """Depth that was computed of upright pictures is not taken for that of stored ones."""
    save(tmp_path / "a.jpg", pattern(0), 6)

    assert (
        ImageFrames(tmp_path / "a.jpg").digest
        != ImageFrames(tmp_path / "a.jpg", as_stored=True).digest
    )


def test_rgbd_takes_pixels_as_they_are_stored(tmp_path):
    """Depth maps and poses beside them know of no tag."""
    folder = CAPTURES["rgbd"](tmp_path / "room")
    clean = open_capture(folder)
    first = clean.frame(clean.camera_names[0], 0)
    for file in (folder / "color").iterdir():
        save(file, read_image(file), 3)

    capture = open_capture(folder)

    assert np.abs(capture.frame(capture.camera_names[0], 0).astype(int) - first).mean() < 3
    assert any("EXIF" in note and "stored" in note for note in capture.notes)


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_calibration_computes_on_the_pixels_that_are_read_later(orientation, tmp_path):
    """COLMAP ignores the tag: what it gets is upright and without one, and so is what becomes the
    capture.
    """
    stills = {name: ImageFrames(tmp_path / "in" / f"{name}.jpg") for name in NAMES}
    for index, still in enumerate(stills.values()):
        save(still.path, pattern(index), orientation)

    images = write_instant(stills, 0, tmp_path / "work")
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    handed = {
        name: cv2.imread(str(tmp_path / "work" / image), flags) for name, image in images.items()
    }
    (tmp_path / "rig").mkdir()
    link_frames(
        stills,
        {name: tmp_path / "work" / image for name, image in images.items()},
        tmp_path / "rig",
    )

    for name, still in stills.items():
        shown = next(still.frames(0, 1))
        np.testing.assert_array_equal(handed[name][..., ::-1], shown)
        np.testing.assert_array_equal(read_image(tmp_path / "rig" / "images" / images[name]), shown)
        assert images[name] == (f"{name}.jpg" if orientation == 1 else f"{name}.png")
        assert not ImageFrames(tmp_path / "rig" / "images" / images[name]).orientations
