"""DyNeRF captures: camXX.mp4 or frame folders with poses_bounds.npy."""

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.video import VideoFrames
from helpers.captures import (
    FPS,
    HEIGHT,
    N_FRAMES,
    NAMES,
    WIDTH,
    make_image,
    make_rig,
    mean_colours,
    refusal,
    write_dynerf,
    write_folders,
    write_poses,
    write_videos,
)


def test_opens_as_filmed(dynerf):
    """Cameras, frames and rate are those that were written, and every frame is the right one of the
    right camera.
    """
    capture = open_capture(dynerf)
    assert (capture.layout, capture.scene, capture.camera_names) == ("dynerf", "room", NAMES)
    assert (capture.n_frames, capture.fps) == (N_FRAMES, FPS)
    for index, (camera, truth) in enumerate(zip(capture.cameras, make_rig(), strict=True)):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-12)
        np.testing.assert_allclose(camera.K, truth.K, atol=1e-12)
        assert (camera.size, camera.near, camera.far) == ((WIDTH, HEIGHT), 2.0, 8.0)
        assert mean_colours(capture, camera.name) == [(frame, index) for frame in range(N_FRAMES)]


def test_rows_follow_sorted_names_not_numbers(tmp_path):
    """Where camera numbers are missing, row i belongs to the i-th name, not to the number in it."""
    names = ("cam00", "cam02", "cam07", "cam11")
    capture = open_capture(write_dynerf(tmp_path / "scene", names))
    assert capture.camera_names == names
    for camera, truth in zip(capture.cameras, make_rig(names), strict=True):
        np.testing.assert_allclose(camera.centre, truth.centre, atol=1e-12)


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("pattern", ["{}/images", "frames/{}", "frames_2/{}", "images/{}"])
def test_frame_folders(tmp_path, pattern, first):
    """Each arrangement of frame folders opens, counted from 0 or from 1, to the same frames."""
    names = tuple(name.removeprefix("cam") for name in NAMES) if pattern == "images/{}" else NAMES
    write_folders(tmp_path, names, pattern, first)
    write_poses(tmp_path, make_rig(names))
    capture = open_capture(tmp_path)
    assert (capture.camera_names, capture.n_frames, capture.fps) == (names, N_FRAMES, 30.0)
    for index, name in enumerate(names):
        assert all(
            np.array_equal(image, make_image(index, t))
            for t, image in enumerate(capture.frames(name))
        )


def test_videos_come_before_folders(dynerf):
    """Where videos and extracted frames lie side by side, the videos are read."""
    write_folders(dynerf, NAMES[:2])
    assert open_capture(dynerf).camera_names == NAMES
    assert all(isinstance(source, VideoFrames) for source in open_capture(dynerf).sources)


def test_focal_length_follows_the_size_of_the_frames(tmp_path):
    """Poses made for images of twice the size give half the focal length and the centre of the
    smaller image.
    """
    write_videos(tmp_path)
    write_poses(tmp_path, make_rig(width=2 * WIDTH, height=2 * HEIGHT))
    camera = open_capture(tmp_path).cameras[0]
    np.testing.assert_allclose(camera.K, make_rig()[0].K)
    assert camera.size == (WIDTH, HEIGHT)


@pytest.mark.parametrize(("drop", "count"), [(True, 3), (False, 4)])
def test_coffee_martini_drops_cam13_by_name(tmp_path, drop, count):
    """cam13 of coffee_martini, out of step, is left out unless asked for; the other cameras keep
    their rows.
    """
    names = ("cam11", "cam12", "cam13", "cam14")
    capture = open_capture(write_dynerf(tmp_path / "coffee_martini", names), drop_unsynced=drop)
    assert len(capture.cameras) == count
    assert ("cam13" in capture.camera_names) is not drop
    np.testing.assert_allclose(
        capture.camera("cam14").centre, make_rig(names)[3].centre, atol=1e-12
    )


def test_missing_video(dynerf):
    """A missing video shows as a row too many, with the cameras that are there."""
    (dynerf / "cam02.mp4").unlink()
    assert (
        "3 cameras on disk (cam00, cam01, cam03), got 4 rows; restore the missing cameras"
        in refusal(dynerf)
    )


def test_names_of_different_length(dynerf):
    """Names without leading zeros have no safe order and are refused."""
    (dynerf / "cam03.mp4").rename(dynerf / "cam3.mp4")
    assert "; add leading zeros" in refusal(dynerf)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:3], "got 3 rows; restore the missing rows"),
        (
            lambda rows: rows[:, :15],
            r"wanted an N x 17 array of numbers (LLFF), got (4, 15) float64",
        ),
        (lambda rows: rows.ravel(), "got (68,) float64"),
        (
            lambda rows: rows.astype(object),
            "Object arrays cannot be loaded when allow_pickle=False",
        ),
        (lambda rows: rows.astype(str), "got (4, 17) <U32"),
        (
            lambda rows: np.where(np.arange(4)[:, None] == 2, np.nan, rows),
            "got NaN or infinity in row 2 (from 0)",
        ),
        (lambda rows: rows * [1.0, 2.0, *[1.0] * 15], "the rotation must be orthonormal"),
        (lambda rows: rows[:, [*range(15), 16, 15]], "0 < near < far, got 8 .. 2"),
    ],
    ids=["row count", "columns", "flat", "pickled", "text", "NaN", "no rotation", "bounds"],
)
def test_pose_file_that_makes_no_sense(dynerf, change, message):
    """Every way in which poses can be wrong is told apart, naming the file."""
    poses = dynerf / "poses_bounds.npy"
    rows = np.load(poses)
    np.save(poses, change(rows))
    found = refusal(dynerf)
    assert message in found
    assert "poses_bounds.npy" in found


def test_pose_file_that_is_no_array(dynerf):
    """A pose file that is no npy file is not unpickled but refused."""
    (dynerf / "poses_bounds.npy").write_text("not an array")
    assert "wanted an N x 17 array of numbers (LLFF), got: " in refusal(dynerf)
