"""Panoptic Sports: cameras of both files, frames in the order of the file, damage in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.protocol import load_protocol
from helpers.captures import make_rig, mean_colours, refusal
from helpers.community_layouts import N_INSTANTS, write_panoptic
from helpers.places import SHARED

REAL = SHARED / "data" / "panoptic_basketball"


@pytest.fixture
def scene(tmp_path) -> Path:
    return write_panoptic(tmp_path / "basketball")


def edit(scene: Path, change, file: str = "train_meta.json") -> None:
    """Change the values of a file."""
    values = json.loads((scene / file).read_text())
    change(values)
    (scene / file).write_text(json.dumps(values))


def test_both_files_are_one_rig(scene):
    """Cameras are called as their folders, in the order of their numbers, with the pose and
    intrinsics of the file, metric.
    """
    capture = open_capture(scene)
    assert (capture.layout, capture.camera_names, capture.n_frames) == (
        "panoptic",
        ("0", "3", "10"),
        N_INSTANTS,
    )
    assert capture.units_per_metre == 1.0
    assert mean_colours(capture, "10") == [(0, 2), (1, 2)]
    for camera, calibrated in zip(capture.cameras, make_rig(("0", "3", "10")), strict=True):
        np.testing.assert_allclose(camera.K, calibrated.K)
        np.testing.assert_allclose(camera.world_to_camera, calibrated.world_to_camera)


def test_frames_come_in_the_order_of_the_file(scene):
    """The names of images say nothing of time, their place does."""
    edit(scene, lambda values: values["fn"].reverse())
    assert mean_colours(open_capture(scene), "10") == [(1, 2), (0, 2)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda values: values.pop("w2c"), "got: no 'w2c'"),
        (lambda values: values["w2c"][1][0][0].__setitem__(3, 0.5), "w2c of camera 0 that changes"),
        (lambda values: values["k"][1][1][0].__setitem__(0, 70.0), "k of camera 10 that changes"),
        (lambda values: values["fn"][1].pop(), "instants that differ in their cameras"),
        (lambda values: values["fn"][0].__setitem__(0, "../x/0.png"), r"wanted CAM/FRAME.jpg"),
        (
            lambda values: values["fn"][1].__setitem__(0, "10/000001.png"),
            "images of several folders for camera 0",
        ),
        (lambda values: values["k"][0].pop(), "wanted w, h"),
    ],
)
def test_damage_is_one_line(scene, change, message):
    """The file, what was wanted and what came."""
    edit(scene, change)
    assert message in refusal(scene)
    assert "train_meta.json" in refusal(scene)


def test_a_missing_image_is_named(scene):
    """Listed, and not there."""
    (scene / "ims" / "10" / "000001.png").unlink()
    assert "000001.png" in refusal(scene)


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="the real capture is not here")
def test_the_real_capture_opens():
    """31 cameras of 640 x 360; the protocol's test views are those of the second file."""
    capture = open_capture(REAL)
    assert (len(capture.cameras), capture.n_frames, capture.cameras[0].size) == (31, 40, (640, 360))
    protocol = load_protocol("panoptic_sports")
    assert {*protocol.views.test, *protocol.views.sources} == set(capture.camera_names)
