"""Opening a capture: detection of the layout, units, the camera path of a synthetic capture, and
what is refused.
"""

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import DATASETS, open_capture
from ggvs_eval.datasets.llff import open_path
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from helpers.captures import (
    make_image,
    make_rig,
    mean_colours,
    refusal,
    write_colmap,
    write_poses,
)
from helpers.refusals import refused


def test_registry_describes_each_layout():
    """Every layout has one line of description and refuses an unrelated folder with a reason."""
    for spec in DATASETS.values():
        assert "\n" not in spec.describe
        assert spec.refuse(Path(__file__).parent)


@pytest.mark.parametrize("units", [0.0, -2.0, float("nan"), float("inf")])
def test_units_must_be_positive(dynerf, units):
    """A unit that is not a positive number is refused."""
    with refused(CaptureError, "positive", "per metre"):
        open_capture(dynerf, units=units)


def test_no_folder_no_content_no_layout(tmp_path):
    """An absent path, a file, an empty folder and a folder of other things get a message each."""
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "cam00.mp4").write_bytes(b"x")
    assert "got no such path; check it" in refusal(tmp_path / "absent")
    assert f"got no such path; did you mean {tmp_path}/other?" in refusal(tmp_path / "othr")
    assert f"got another file; give its folder, {tmp_path.name}" in refusal(tmp_path / "file")
    assert "got an empty folder" in refusal(tmp_path / "empty")
    message = refusal(tmp_path / "other")
    assert (
        "wanted a capture in a known layout; see docs/captures.md for the layouts (looked for: not "
        "capture.toml: " in message
    )
    assert all(f"not {name}: " in message for name in DATASETS)
    assert "not dynerf: no poses_bounds.npy" in message


def test_poses_without_frames(tmp_path):
    """Poses alone are refused with the arrangements of frames that are looked for."""
    write_poses(tmp_path, make_rig())
    assert "poses_bounds.npy, but no frames (camXX.mp4" in refusal(tmp_path)


def test_unknown_layout(dynerf):
    """It is refused with the nearest known one; a known one that does not fit is not replaced by
    another.
    """
    assert (
        f"wanted a layout of {', '.join(DATASETS)}, got 'dynerfs'; did you mean dynerf?"
        in refusal(dynerf, "dynerfs")
    )
    assert refusal(dynerf, "???").endswith(f"wanted a layout of {', '.join(DATASETS)}, got '???'")
    assert "not colmap" in refusal(dynerf, "colmap")


def test_a_whole_data_set(dynerf, tmp_path):
    """Where a data set's root is named instead of a scene, the captures in it are listed, but not
    hundreds.
    """
    root = tmp_path / "data_set"
    write_colmap(root / "office")
    shutil.copytree(dynerf, root / "coffee")
    (root / "licence").mkdir()
    assert refusal(root).startswith(
        f"{root}: wanted a capture in a known layout; name one of the captures in it: coffee, "
        f"office ("
    )
    for index in range(25):
        shutil.copytree(dynerf, root / f"scene{index:02d}")
    assert "scene21 and 3 more (looked for: " in refusal(root)


def test_captures_travel_between_processes(dynerf):
    """An opened capture can be pickled, so that jobs run in other processes."""
    capture = pickle.loads(pickle.dumps(open_capture(dynerf)))
    assert mean_colours(capture, "cam01")[2] == (2, 1)


def test_path_with_and_without_images(dynerf):
    """Poses open alone, and with one image each and the instant they show; another number of images
    is refused.
    """
    rig = make_rig()
    write_poses(dynerf / "path", rig)
    alone = open_path(dynerf)
    (dynerf / "other").mkdir()
    (dynerf / "other" / "a.txt").touch()
    assert open_capture(dynerf).notes == ("not used: other/",)  # and the path is, later
    assert alone is not None
    assert (alone.images, alone.time_s) == (None, 0.0)
    assert [camera.name for camera in alone.cameras] == [
        "path0000",
        "path0001",
        "path0002",
        "path0003",
    ]
    for index in range(4):
        write_image(dynerf / "path" / "images" / f"{index:04d}.png", make_image(index, 0))
    (dynerf / "demo.json").write_text(json.dumps({"units_per_metre": 1.0, "path_time_s": 0.4}))
    with_images = open_path(dynerf)
    assert with_images is not None
    assert with_images.images is not None
    assert with_images.time_s == 0.4
    assert np.array_equal(next(with_images.images.frames(2, 3)), make_image(2, 0))
    np.testing.assert_allclose(with_images.cameras[3].centre, rig[3].centre, atol=1e-12)
    (dynerf / "path" / "images" / "0003.png").unlink()
    with refused(CaptureError, "4 images", "poses_bounds.npy", "got 3"):
        open_path(dynerf)
