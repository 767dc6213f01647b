"""Folders of images as frames: nothing may shift in time or change size unnoticed."""

import shutil

import pytest

from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.images import write_image
from helpers.captures import (
    NAMES,
    make_image,
    make_rig,
    refusal,
    write_folders,
    write_poses,
)


def test_numbers_are_sorted_as_numbers(tmp_path):
    """Frame 10 comes after frame 9, and even steps other than 1 are accepted."""
    for frame in range(0, 12, 2):
        write_image(tmp_path / f"{frame}.png", make_image(0, frame // 2))
    assert [file.stem for file in ImageFrames(tmp_path).files] == ["0", "2", "4", "6", "8", "10"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "0002.png").unlink(), "4 images with gaps between 1 and 3; restore the frames"),
        (lambda folder: shutil.copy(folder / "0002.png", folder / "0002.jpg"), "got several with the number 2"),
        (
            lambda folder: write_image(folder / "0003.png", make_image(0, 0, 32, 24)),
            "0003.png: wanted 64 x 48 like the camera's",
        ),
        (lambda folder: (folder / "0003.png").write_bytes(b"no image"), "0003.png: wanted an image, got 8 bytes"),
        (lambda folder: [file.unlink() for file in folder.iterdir()], "wanted images (.png, .jpg, .jpeg), got none"),
        (lambda folder: shutil.rmtree(folder), "got 4 rows"),
    ],
    ids=["gap", "two of one number", "size", "no image", "empty", "absent"],
)
def test_folder_that_cannot_be_read(tmp_path, change, message):
    """Gaps, doubles, odd sizes, damaged images and empty folders are refused, naming the file or folder."""
    write_folders(tmp_path)
    write_poses(tmp_path, make_rig())
    change(tmp_path / "cam01" / "images")
    if message == "got 4 rows":
        shutil.rmtree(tmp_path / "cam01")
    assert message in refusal(tmp_path)


def test_image_that_ends_early(tmp_path):
    """An image whose header is whole but whose data end early is refused when it is read."""
    write_folders(tmp_path)
    write_poses(tmp_path, make_rig())
    file = tmp_path / "cam01" / "images" / "0003.png"
    file.write_bytes(file.read_bytes()[:-40])
    assert "0003.png: wanted an image" in refusal(tmp_path)


def test_digest_follows_the_content(tmp_path):
    """The digest stays when a folder is moved and changes with any image in it."""
    write_folders(tmp_path / "a", NAMES[:1])
    digest = ImageFrames(tmp_path / "a" / "cam00" / "images").digest
    shutil.move(tmp_path / "a", tmp_path / "b")
    assert ImageFrames(tmp_path / "b" / "cam00" / "images").digest == digest
    write_image(tmp_path / "b" / "cam00" / "images" / "0004.png", make_image(1, 4))
    assert ImageFrames(tmp_path / "b" / "cam00" / "images").digest != digest
