"""Faults planted in the demo: each is of the stated size, and nothing else changes."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.shots import path_shots, rig_shots
from ggvs_eval.errors import CaptureError

pytestmark = pytest.mark.usefixtures("lit_quickly")

TINY = DemoOptions(
    width=32,
    height=24,
    n_frames=3,
    cameras_per_row=2,
    path_poses=2,
    supersampling=1,
    noise_sigma_255=0.0,
)


@pytest.fixture(scope="module")
def with_and_without(tmp_path_factory):
    """Frames (N, F, H, W, 3) and pose rows of a small noiseless demo, and of one with a fault in
    each camera.
    """
    faults = {
        "frame_offset": (("cam00", -1), ("cam02", 1)),
        "camera_gain": (("cam03", 1.15),),
        "focal_error": (("cam01", 1.05),),
    }
    read = []
    for knobs in ({}, faults):
        options = replace(TINY, layout="d3dmv", depth_stride=0, **knobs)
        folder = write_demo(tmp_path_factory.mktemp("faults") / "demo", options, workers=1)
        with h5py.File(folder / "scene000.h5") as file:
            read += [file["rgb"][:], np.load(folder / "scene000_pb.npy")]
    return read


@pytest.mark.proof
def test_another_noise_seed_films_the_same_room_again(with_and_without, tmp_path):
    """Frames differ by the noise of two recordings and by nothing else; cameras are the same, and
    without noise so are frames.
    """
    plain, poses, *_ = with_and_without
    films = []
    for noise_seed, sigma in ((0, 2.0), (1, 2.0), (1, 0.0)):
        options = replace(
            TINY, layout="d3dmv", depth_stride=0, noise_sigma_255=sigma, noise_seed=noise_seed
        )
        folder = write_demo(tmp_path / f"{noise_seed}-{sigma}", options, workers=1)
        with h5py.File(folder / "scene000.h5") as file:
            films.append(file["rgb"][:].astype(float))
        np.testing.assert_array_equal(np.load(folder / "scene000_pb.npy"), poses)
    first, again, clean = films

    np.testing.assert_array_equal(clean, plain)
    middle = (plain > 20) & (plain < 235)
    assert (first - plain)[middle].std() == pytest.approx(2.0, rel=0.03)
    assert (first - again)[middle].std() == pytest.approx(2.0 * np.sqrt(2), rel=0.03)
    assert abs(np.corrcoef((first - plain)[middle], (again - plain)[middle])[0, 1]) < 0.05


@pytest.mark.slow
def test_frame_offset_shows_other_instants(with_and_without):
    """Frame t of one camera is frame t + 1 of the truth, of another frame t - 1; beyond the ends
    time goes on.
    """
    plain, _, shifted, _ = with_and_without

    np.testing.assert_array_equal(shifted[2, :2], plain[2, 1:])
    np.testing.assert_array_equal(shifted[0, 1:], plain[0, :2])
    assert (shifted[2, 2] != plain[2, 2]).any()
    assert (shifted[0, 0] != plain[0, 0]).any()


@pytest.mark.slow
def test_camera_gain_brightens_one_camera(with_and_without):
    """The images of the named camera are brighter by the factor."""
    plain, _, bright, _ = with_and_without
    unclipped = (bright[3] > 20) & (bright[3] < 255)

    assert bright[3][unclipped].mean() / plain[3][unclipped].mean() == pytest.approx(
        1.15, abs=0.005
    )


@pytest.mark.slow
def test_focal_error_changes_one_number(with_and_without):
    """The written focal length of the named camera is scaled, its images keep every bit, and no
    pose changes.
    """
    plain, poses, images, wrong = with_and_without
    expected = poses.copy()
    expected[1, 14] *= 1.05

    np.testing.assert_array_equal(images[1], plain[1])
    np.testing.assert_allclose(wrong[:, :15], expected[:, :15])


@pytest.mark.slow
def test_calibration_error_has_the_stated_size():
    """Over many cameras the image's centre moves by the wanted standard deviation along both axes;
    no camera moves its place.
    """
    options = replace(TINY, width=480, height=360, cameras_per_row=1000, calibration_error_px=3.0)
    moved_px = []
    for shot in rig_shots(options):
        ahead = shot.camera.centre + 10 * shot.camera.axis
        moved_px.append(shot.noted.project(ahead)[0] - shot.camera.project(ahead)[0])
        np.testing.assert_allclose(shot.noted.centre, shot.camera.centre, atol=1e-9)

    np.testing.assert_allclose(np.std(moved_px, axis=0), 3.0, rtol=0.06)
    np.testing.assert_allclose(np.mean(moved_px, axis=0), 0.0, atol=0.3)


def test_the_true_path_knows_no_faults():
    """The camera path beside the videos is exact whatever errors the rig has."""
    faulty = replace(
        TINY, calibration_error_px=5.0, focal_error=(("cam00", 1.05),), frame_offset=(("cam00", 2),)
    )
    for shot, plain in zip(path_shots(faulty), path_shots(TINY), strict=True):
        np.testing.assert_array_equal(shot.noted.world_to_camera, plain.camera.world_to_camera)
        np.testing.assert_array_equal(shot.noted.K, plain.camera.K)
        assert shot.instants == plain.instants


@pytest.mark.parametrize(
    ("knobs", "message"),
    [
        ({"layout": "n3dv"}, "wanted a layout of dynerf, .*, panoptic, got 'n3dv'"),
        ({"layout": "technicolor"}, "the shape of 2048 x 1088, got 32 x 24; use 512 x 272"),
        (
            {"camera_gain": (("cam04", 1.1),)},
            r"camera_gain names cam04, the cameras are cam00\.\.cam03",
        ),
        (
            {"layout": "rgbd", "focal_error": (("cam01", 1.1),)},
            "focal_error names cam01, the cameras are cam00;",
        ),
        (
            {"camera_gain": (("cam01", 0.0),)},
            "camera_gain of cam01 must be a positive factor, got 0",
        ),
        (
            {"focal_error": (("cam01", float("nan")),)},
            "focal_error of cam01 must be a positive factor, got nan",
        ),
        ({"focal_error": (("cam01", 1.1), ("cam01", 1.2))}, "wants each camera once"),
        (
            {"frame_offset": (("cam01", 1.5),)},
            "frame_offset of cam01 must be a whole number of frames, got 1.5",
        ),
        ({"layout": "rgbd", "frame_offset": (("cam00", 1),)}, "rgbd has one"),
        ({"calibration_error_px": -1.0}, "calibration_error_px must not be negative, got -1"),
    ],
)
def test_impossible_knobs_are_refused(knobs, message):
    """A layout or camera that does not exist, and a value that means nothing, are refused
    by name.
    """
    with pytest.raises(CaptureError, match=message):
        replace(TINY, **knobs)
