"""Google Immersive: cameras and lenses as the data set's README defines them, frames without
fisheye, damage in one line.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import write_image
from helpers.captures import WIDTH, make_image, make_rig, mean_colours, refusal
from helpers.community_layouts import (
    N_INSTANTS,
    PAIR,
    README_VIEW,
    copied,
    immersive_model,
    with_pictures,
    write_immersive,
    write_models,
)

NAMES = ("camera_0001", "camera_0002")


@pytest.fixture(scope="module")
def flames(tmp_path_factory) -> Path:
    """A scene that nobody changes."""
    return write_immersive(tmp_path_factory.mktemp("immersive") / "02_Flames")


@pytest.fixture
def scene(flames, tmp_path) -> Path:
    """An intact scene to damage."""
    return copied(flames, tmp_path / "02_Flames")


def models_of(names=PAIR) -> list:
    """The content of models.json."""
    return [
        immersive_model(camera, f"camera_{index + 1:04d}")
        for index, camera in enumerate(make_rig(names))
    ]


def test_projects_as_the_readme_says(tmp_path):
    """The README's camera sees the world point (0.5, 0.5, 10) at (1377.85525, 1017.61440) of its
    2560 x 1920 fisheye image.
    """
    write_models(tmp_path, [README_VIEW])
    write_image(tmp_path / "camera_0001" / "0.png", make_image(0, 0))
    capture = open_capture(tmp_path)

    source, camera = capture.sources[0], capture.cameras[0]
    uv, _ = camera.project(np.array([0.5, 0.5, 10.0]))
    seen = source.lens.distort(uv[None], camera.K)[0] * (2560 / WIDTH)
    np.testing.assert_allclose(seen, (1377.85525, 1017.61440), atol=1e-5)


def test_opens_videos_and_extracted_pictures(flames, scene):
    """Cameras are called as in the file; the lens leaves the pinhole image its K; pictures do as
    well as videos.
    """
    for path in (flames, with_pictures(scene)):
        capture = open_capture(path)
        assert (capture.layout, capture.camera_names, capture.n_frames) == (
            "immersive",
            NAMES,
            N_INSTANTS,
        )
        assert (capture.units_per_metre, capture.units_origin) == (
            1.0,
            "assumed of its form, which is that of a metric data set",
        )
        assert [colour[0] for colour in mean_colours(capture, "camera_0002")] == [0, 1]
        for camera, other in zip(capture.cameras, make_rig(PAIR), strict=True):
            np.testing.assert_allclose(camera.K, other.K)
            np.testing.assert_allclose(camera.world_to_camera, other.world_to_camera, atol=1e-12)


def test_depth_range_is_the_scenes(flames, tmp_path):
    """Scenes that HyperReel knows by their number have its range; of others the rig says it."""
    assert {(camera.near, camera.far) for camera in open_capture(flames).cameras} == {(1.0, 10.0)}
    other = open_capture(copied(flames, tmp_path / "kitchen")).cameras[0]
    assert (other.near, other.far) != (1.0, 10.0)
    (tmp_path / "kitchen" / "depth_range.toml").write_text("near = 1.5\nfar = 4\n")
    assert {(camera.near, camera.far) for camera in open_capture(tmp_path / "kitchen").cameras} == {
        (1.5, 4.0)
    }


def test_cameras_without_frames_are_left_out(scene):
    """Some scenes lack cameras; what is left is read, and the note says which are absent. Without
    any it is no capture.
    """
    write_models(scene, [*models_of(), immersive_model(make_rig(PAIR)[1], "camera_0007")])
    capture = open_capture(scene)
    assert capture.camera_names == NAMES
    assert "camera_0007 left out: calibrated, but without frames" in capture.notes

    write_models(scene, [immersive_model(make_rig(PAIR)[1], "camera_0007")])
    assert (
        "wanted frames of camera_0007, got none, but there is CAM.mp4 (camera_0001, camera_0002)"
        in refusal(scene)
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda models: models[0].update(projection_type="other"),
            "wanted 'fisheye' as projection_type of camera_0001",
        ),
        (
            lambda models: models[0].pop("projection_type"),
            "projection_type of camera_0001, got None; no other lens",
        ),
        (
            lambda models: models[1].update(radial_distortion=[0.1, 0.0, 0.2]),
            "0 as third radial_distortion of camera_0002",
        ),
        (
            lambda models: models[1].update(radial_distortion=[0.1]),
            "wanted 3 finite numbers as radial_distortion of camera_0002",
        ),
        (
            lambda models: models[1].update(radial_distortion=[9000.0, 9.0, 0.0]),
            "coefficients (9000.0, 9.0, 0.0, 0.0)",
        ),
        (
            lambda models: models[0].update(name="../camera_0001"),
            "wanted camera_XXXX as name of camera 0, got '../camera_0001'",
        ),
        (
            lambda models: models[0].update(focal_length=None),
            "a finite number as focal_length of camera 0, got None",
        ),
        (
            lambda models: models[0].update(focal_length=-3.0),
            "camera_0001: lens: K must be fx 0 cx",
        ),
        (lambda models: models[0].update(width=50.0), "camera_0001"),
        (lambda models: models.append("camera"), "camera 2, got 'camera' for the camera"),
        (
            lambda models: models.append(models[0]),
            "cameras of different names, got several called camera_0001",
        ),
        (lambda models: models.clear(), "wanted a list of cameras, got another structure"),
    ],
)
def test_models_that_make_no_sense(scene, change: Callable[[list], object], message):
    """Whatever is wrong with a camera is said with its key and place, in one line."""
    models = models_of()
    change(models)
    write_models(scene, models)
    assert message in refusal(scene, "immersive")


def test_spaces_and_immersive_are_told_apart(scene, tmp_path):
    """Both come with models.json; the names of the cameras say which it is."""
    assert re.search(r"not spaces: models.json, but no cam_XX/", refusal(scene, "spaces"))
    (tmp_path / "models.json").write_text("[]")
    assert "models.json, but no camera_XXXX" in refusal(tmp_path, "immersive")
