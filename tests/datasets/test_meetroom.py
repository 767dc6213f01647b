"""MeetRoom: StreamRF's videos without leading zeros and what its script extracts of them, damage in
one line.
"""

from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from helpers.captures import make_rig, mean_colours, refusal, write_dynerf
from helpers.community_layouts import N_INSTANTS, copied, write_extracted, write_meetroom

# Of which text sorts the last before the second.
NAMES = ("cam00", "cam02", "cam10")


@pytest.fixture(scope="module")
def discussion_folder(tmp_path_factory) -> Path:
    """A capture that nobody changes."""
    return write_meetroom(tmp_path_factory.mktemp("meetroom") / "discussion", NAMES)


@pytest.mark.parametrize("arrangement", ["videos", "instants", "frames/"])
def test_rows_follow_the_numbers(discussion_folder, tmp_path, arrangement):
    """cam_2 comes before cam_10: row i is of the i-th camera by number, in videos and in a folder
    per instant.
    """
    folders = {"instants": tmp_path / "trimming", "frames/": tmp_path / "trimming" / "frames"}
    if arrangement in folders:
        write_extracted(folders[arrangement], NAMES)
    capture = open_capture(tmp_path / "trimming" if arrangement in folders else discussion_folder)

    assert (capture.layout, capture.camera_names, capture.n_frames) == (
        "meetroom",
        NAMES,
        N_INSTANTS,
    )
    for index, (camera, other) in enumerate(zip(capture.cameras, make_rig(NAMES), strict=True)):
        np.testing.assert_allclose(camera.centre, other.centre, atol=1e-12)
        assert mean_colours(capture, camera.name) == [(0, index), (1, index)]


def test_videos_of_dynerf_beside_extracted_folders_are_dynerfs(tmp_path):
    """cam00.mp4 is Neural 3D Video's, whatever else lies in the folder."""
    write_extracted(write_dynerf(tmp_path, NAMES) / "frames", NAMES)
    assert open_capture(tmp_path).layout == "dynerf"


def test_rows_and_cameras_must_match(discussion_folder, tmp_path):
    """A row too many or too few names the cameras that are there."""
    scene = copied(discussion_folder, tmp_path / "scene")
    (scene / "cam_2.mp4").unlink()
    assert "got 3 rows; restore the missing cameras" in refusal(scene)
    (scene / "poses_bounds.npy").unlink()
    assert "not meetroom: cam_<N>.mp4, but no poses_bounds.npy" in refusal(scene)


def test_an_instant_without_a_camera(tmp_path):
    """A picture that is missing among the instants is a camera with fewer frames."""
    scene = write_extracted(tmp_path / "scene", NAMES)
    (scene / "0001" / "images" / "cam02.png").unlink()
    assert "wanted one frame count for all cameras, got cam00 2, cam02 1, cam10 2" in refusal(scene)
