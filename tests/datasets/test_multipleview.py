"""The multipleview layout of 4D Gaussian Splatting: camXX/frame_00001.jpg with a COLMAP model in
sparse_/.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import write_image
from helpers.captures import NAMES, make_binary, make_image, make_rig, refusal, write_colmap_model
from helpers.small_layouts import N_INSTANTS, write_multipleview

FOLDERS = ("cam01", "cam02", "cam03", "cam04")


@pytest.fixture
def scene_folder(tmp_path) -> Path:
    return write_multipleview(tmp_path / "scene")


@pytest.mark.parametrize("binary", [False, True])
def test_opens_as_calibrated(scene_folder, binary):
    """image2.png of the model is the camera of cam02/, whose frames count from 1."""
    if binary:
        make_binary(scene_folder / "sparse_")
    read = open_capture(scene_folder)
    assert (read.layout, read.camera_names, read.n_frames, read.fps) == (
        "multipleview",
        FOLDERS,
        N_INSTANTS,
        30.0,
    )
    for index, (camera, truth) in enumerate(zip(read.cameras, make_rig(), strict=True)):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-9)
        np.testing.assert_allclose(camera.K, truth.K)
        assert np.array_equal(read.frame(camera.name, 1), make_image(index, 1))
    assert read.units_origin == "guess: median scene depth taken for 2 m"


def test_leading_zeros_and_more_than_nine_cameras(tmp_path):
    """The number counts: image010.png belongs to cam10, whatever the order of names."""
    numbers = (2, 10, 1)
    for number in numbers:
        write_image(tmp_path / f"cam{number:02d}" / "frame_00001.png", make_image(number, 0))
    write_colmap_model(tmp_path / "sparse_", ["image2.png", "image010.png", "image1.png"])
    read = open_capture(tmp_path)
    assert read.camera_names == ("cam01", "cam02", "cam10")
    by_number = dict(zip(numbers, make_rig(NAMES[:3]), strict=True))
    for number, camera in zip((1, 2, 10), read.cameras, strict=True):
        np.testing.assert_allclose(camera.centre, by_number[number].centre, atol=1e-9)
        assert np.array_equal(read.frame(camera.name, 0), make_image(number, 0))


@pytest.mark.parametrize(
    "folders", [("cam01", "cam03", "cam04", "cam07", "cam1"), ("cam01", "cam03", "cam04")]
)
def test_folders_of_other_numbers(scene_folder, folders):
    """Two of one number, or fewer than the model has images: which is meant is not guessed, and
    both sides are listed.
    """
    shutil.rmtree(scene_folder / "cam02")
    for name in folders[3:]:
        shutil.copytree(scene_folder / "cam01", scene_folder / name, dirs_exist_ok=True)
    assert f"image4, got none, but there is CAM/ ({', '.join(folders)})" in refusal(scene_folder)
