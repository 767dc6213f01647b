"""Technicolor's light-field videos: parameters and pictures as HyperReel and SpacetimeGaussians
read them, damage in one line.
"""

from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import write_image
from helpers.captures import make_image, make_rig, mean_colours, refusal
from helpers.community_layouts import (
    N_INSTANTS,
    PAIR,
    SMALL_SIZE,
    TECHNICOLOR_SIZE,
    copied,
    write_technicolor,
)


@pytest.fixture
def scene(tmp_path) -> Path:
    return write_technicolor(tmp_path / "Painter")


def edit_row(scene: Path, change) -> None:
    """Change the words of the second camera's row."""
    file = scene / "cameras_parameters.txt"
    lines = file.read_text().splitlines()
    lines[2] = " ".join(change(lines[2].split()))
    file.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(("first", "pictures"), [(1, "."), (0, "."), (151, "images")])
def test_opens_pictures_of_all_cameras_in_one_folder(tmp_path, first, pictures):
    """Frames are told by the first number and cameras by the second, whatever the first frame's
    number; sizes scale.
    """
    capture = open_capture(write_technicolor(tmp_path / "Train", first=first, pictures=pictures))

    assert (capture.layout, capture.scene, capture.camera_names, capture.n_frames) == (
        "technicolor",
        "Train",
        PAIR,
        N_INSTANTS,
    )
    assert mean_colours(capture, "cam01") == [(0, 1), (1, 1)]
    for camera, calibrated in zip(capture.cameras, make_rig(PAIR, *TECHNICOLOR_SIZE), strict=True):
        np.testing.assert_allclose(camera.K, calibrated.resized(*SMALL_SIZE).K, atol=1e-9)
        np.testing.assert_allclose(camera.world_to_camera, calibrated.world_to_camera, atol=1e-12)


def test_projects_by_the_rows_formula(scene):
    """X = R(q) X + t, then f x/z + cu and ar f y/z + cv, on a 32nd of 2048 x 1088; here with q of a
    quarter turn about y.
    """
    half = float(np.sqrt(0.5))
    row = [1600.0, 1020.0, 540.0, 1.01, 0.0, half, 0.0, half, 0.0, 0.1, -0.2, 0.3]
    edit_row(scene, lambda words: map(repr, row))

    uv, depth = open_capture(scene).camera("cam01").project(np.array([-4.0, 0.5, 1.0]))
    x, y, z = 1.0 + 0.1, 0.5 - 0.2, 4.0 + 0.3
    np.testing.assert_allclose(uv * 32, (1600 * x / z + 1020, 1.01 * 1600 * y / z + 540), rtol=1e-9)
    assert depth == pytest.approx(z)


def test_depth_range_is_the_scenes(scene, tmp_path):
    """Scenes that HyperReel knows by name have its range; of others the rig says it, and
    depth_range.toml before either.
    """
    assert {(camera.near, camera.far) for camera in open_capture(scene).cameras} == {(1.75, 10.0)}
    kitchen = copied(scene, tmp_path / "kitchen")
    camera = open_capture(kitchen).cameras[0]
    assert (camera.near, camera.far) != (1.75, 10.0)

    (kitchen / "depth_range.toml").write_text("near = 2\nfar = 7.5\n")
    assert {(camera.near, camera.far) for camera in open_capture(kitchen).cameras} == {(2.0, 7.5)}
    for text, message in (
        ("near = 2\nfar = 2\n", "wanted 0 < near < far in world units, got 2 and 2"),
        ("near = 2\n", "far"),
    ):
        (kitchen / "depth_range.toml").write_text(text)
        assert message in refusal(kitchen)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda words: words[:-1],
            "wanted f cu cv ar sk qw qx qy qz tx ty tz as finite numbers of camera 1, got 1843",
        ),
        (lambda words: ["nan", *words[1:]], "as finite numbers of camera 1, got nan"),
        (lambda words: ["f", *words[1:]], "of each camera, got: line 3: no number in 'f'"),
        (
            lambda words: [*words[:4], "3.5", *words[5:]],
            "and a unit quaternion of camera 1, got 1843.2 1024 544 1 3.5",
        ),
        (
            lambda words: [*words[:5], "2", *words[6:]],
            "and a unit quaternion of camera 1, got 1843.2 1024 544 1 0 2",
        ),
        (lambda words: ["-1", *words[1:]], "cam01: lens: K must be"),
    ],
)
def test_parameters_that_make_no_sense(scene, change, message):
    """Whatever is wrong with a row is said with its camera."""
    edit_row(scene, change)
    assert message in refusal(scene)


def test_pictures_and_rows_must_match(scene):
    """A camera more, a frame less, a cropped picture: each is named."""
    write_image(scene / "Painter_undist_00001_07.png", make_image(0, 0, *SMALL_SIZE))
    assert (
        "wanted pictures of the camera of each row of cameras_parameters.txt, got 07 (pictures "
        "only); restore these" in refusal(scene)
    )
    (scene / "Painter_undist_00001_07.png").unlink()
    (scene / "Painter_undist_00002_01.png").unlink()
    assert "wanted one frame count for all cameras, got cam00 2, cam01 1" in refusal(scene)
    write_image(scene / "Painter_undist_00004_00.png", make_image(0, 0, *SMALL_SIZE))
    assert "got 3 images with gaps between 2 and 4" in refusal(scene)
    for file in scene.glob("*_00.png"):
        file.unlink()
    assert "got 00 (cameras_parameters.txt only)" in refusal(scene)
