"""Folders of images as frames: nothing may shift in time or change size unnoticed."""

import shutil

import pytest

from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from helpers.captures import (
    NAMES,
    make_image,
    make_rig,
    refusal,
    write_folders,
    write_poses,
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda folder: (folder / "0002.png").unlink(),
            "4 images with gaps between 1 and 3; restore the frames",
        ),
        (
            lambda folder: shutil.copy(folder / "0002.png", folder / "0002.jpg"),
            "got several with the number 2",
        ),
        (
            lambda folder: write_image(folder / "0003.png", make_image(0, 0, 32, 24)),
            "0003.png: wanted 64 x 48 like the",
        ),
        (
            lambda folder: (folder / "0003.png").write_bytes(b"no image"),
            "0003.png: wanted an image, got 8 bytes",
        ),
        (lambda folder: [file.unlink() for file in folder.iterdir()], "got 4 rows"),
    ],
    ids=["gap", "two of one number", "size", "no image", "empty"],
)
def test_folder_that_cannot_be_read(tmp_path, change, message):
    """Gaps, doubles, odd sizes, damaged images and empty folders are refused, naming the file or
    folder.
    """
    write_folders(tmp_path)
    write_poses(tmp_path, make_rig())
    change(tmp_path / "cam01" / "images")
    assert message in refusal(tmp_path)


def test_digest_follows_the_content(tmp_path):
    """The digest stays when a folder is moved and changes with any image in it."""
    write_folders(tmp_path / "a", NAMES[:1])
    digest = ImageFrames(tmp_path / "a" / "cam00" / "images").digest
    shutil.move(tmp_path / "a", tmp_path / "b")
    assert ImageFrames(tmp_path / "b" / "cam00" / "images").digest == digest
    write_image(tmp_path / "b" / "cam00" / "images" / "0004.png", make_image(1, 4))
    assert ImageFrames(tmp_path / "b" / "cam00" / "images").digest != digest


@pytest.mark.parametrize(
    "around",
    ["{}", "2024_{}", "{}_64x48", "take3_{}_64x48"],
    ids=["alone", "before", "after", "both"],
)
@pytest.mark.parametrize(
    "numbers",
    [
        ["001", "002", "003", "004"],
        ["10-59-59-400", "10-59-59-600", "10-59-59-800", "11-00-00-000", "11-00-00-200"],
        ["10-59-59-900", "10-59-59-933", "10-59-59-966", "11-00-00-000"],
        ["10-59-59.000", "10-59-59.500", "11-00-00.000", "11-00-00.500"],
    ],
    ids=["count", "even clock", "clock", "half seconds"],
)
def test_numbers_that_vary_order_the_frames(tmp_path, numbers, around):
    """A number that all names share says nothing; several that vary are read from left to right, as
    a clock is.
    """
    for number in reversed(numbers):
        write_image(tmp_path / f"{around.format(number)}.png", make_image(0, 0))
    assert [file.stem for file in ImageFrames(tmp_path).files] == [
        around.format(number) for number in numbers
    ]


def test_pictures_that_share_their_numbers(tmp_path):
    """They are all named, and nothing is said of leaving any of them out."""
    for name in ("left_7", "right_7"):
        write_image(tmp_path / f"{name}.png", make_image(0, 0))
    with pytest.raises(
        CaptureError,
        match=r"several with the number 7 \(left_7.png and right_7.png\); give each a number",
    ):
        _ = ImageFrames(tmp_path).files
