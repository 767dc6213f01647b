"""Frames are found where they lie: sessions of other programs, cards of cameras, proxies, several
kinds of picture.
"""

import json

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.camera_frames import find_rig_frames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from helpers.calibration_files import write_anipose
from helpers.captures import NAMES, make_image, make_rig, refusal, write_videos
from helpers.refusals import refused
from helpers.small_layouts import transforms, write_nerfstudio

LETTERS = ("A", "B", "C", "D")


@pytest.mark.parametrize(
    ("cameras", "videos", "how"),
    [
        (
            LETTERS,
            [f"vid01-cam{letter}" for letter in LETTERS],
            "by the part of the names that varies",
        ),
        (
            [f"cam_{index}" for index in range(4)],
            [f"x_synced_Cam{index + 1}" for index in range(4)],
            "in their order",
        ),
    ],
    ids=["anipose", "freemocap"],
)
def test_a_session_opens_with_its_calibration_beside_the_videos(tmp_path, cameras, videos, how):
    """In folders of their own, under names that differ by what all have in common, or count from
    another number.
    """
    (tmp_path / "calibration").mkdir()
    write_anipose(tmp_path / "calibration" / "calibration.toml", make_rig(cameras))
    write_videos(tmp_path / "videos-raw", videos)
    capture = open_capture(tmp_path)
    assert capture.camera_names == tuple(cameras)
    assert any(
        f"matched to videos-raw/CAM.mp4 {how}: {cameras[0]} {videos[0]}" in note
        for note in capture.notes
    )
    (tmp_path / "videos-raw" / f"{videos[3]}.mp4").unlink()
    assert f"there is videos-raw/CAM.mp4 ({', '.join(videos[:3])})" in refusal(tmp_path)


def test_cards_of_cameras_are_a_rig(tmp_path):
    """One video in each of several folders, however deep; the refusal gives the command
    that works.
    """
    for name in NAMES:
        write_videos(tmp_path / name / "DCIM" / "100GOPRO", ["GX010023"])
    assert tuple(find_rig_frames(tmp_path)) == NAMES
    assert f"'ggvs-eval calibrate {tmp_path} RIG'" in refusal(tmp_path)


def test_splits_are_no_cameras(tmp_path):
    """Folders of the pictures of many cameras; one of them is a rig of stills, as the
    refusal says.
    """
    for split, names in (("train", NAMES), ("test", NAMES[:2])):
        for index, name in enumerate(names):
            write_image(tmp_path / "scene" / split / f"r_{name}.png", make_image(index, 0))
    with refused(
        CaptureError,
        "there is test/CAM.png (r_cam00, r_cam01); train/CAM.png",
        "give the folder of one of these",
    ):
        find_rig_frames(tmp_path / "scene")
    assert len(find_rig_frames(tmp_path / "scene" / "train")) == len(NAMES)


def test_proxies_are_no_cameras(tmp_path):
    """Every video beside one of its name and a word more."""
    write_videos(tmp_path, [*NAMES, *(f"{name}_Proxy" for name in NAMES)])
    with refused(CaptureError, "a smaller copy (proxy) of one recording", "cam00 and cam00_Proxy"):
        find_rig_frames(tmp_path)


def test_kinds_of_picture_in_one_folder(tmp_path):
    """Those in colour are the frames, and a note names the others."""
    write_nerfstudio(tmp_path, transforms())
    for index, name in enumerate(NAMES):
        for frame in range(2):
            write_image(
                tmp_path / "images" / name / f"rgba_{frame:05d}.png", make_image(index, frame)
            )
            write_image(
                tmp_path / "images" / name / f"normal_{frame:05d}.png", make_image(index, 4)
            )
    capture = open_capture(tmp_path)
    assert capture.n_frames == 2
    assert np.array_equal(capture.frame("cam02", 1), make_image(2, 1))
    assert "frames of all cameras are read without normal_ beside them" in capture.notes


def test_a_size_that_is_not_that_of_K_is_refused(tmp_path):
    """In any layout: the principal point is in the middle of the frames, and the file states twice
    their size.
    """
    folder = write_nerfstudio(tmp_path, transforms())
    values = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(
        json.dumps(values | {"w": 2 * values["w"], "h": 2 * values["h"]})
    )
    assert (
        "K of cam00 is of 64 x 48 images, by its principal point (32, 24), its file says 128 x 96"
        in refusal(folder)
    )
