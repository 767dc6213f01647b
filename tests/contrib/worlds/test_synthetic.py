"""The demo capture: a room that is known exactly."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.film.film import Footage, lit_room, read_exact_depth
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import (
    UNITS_PER_METRE,
    eye_in_room,
    rays_in_room,
    rig,
    sideways_path,
)
from ggvs_eval.contrib.worlds.film.shots import camera_gains, rig_shots
from ggvs_eval.contrib.worlds.room.lighting import LitRoom
from ggvs_eval.contrib.worlds.room.room import build_room
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import VideoFrames
from helpers.scenes import render_view

TINY = DemoOptions(width=64, height=48, n_frames=3, cameras_per_row=2, path_poses=2)
CLEAN = replace(TINY, noise_sigma_255=0.0, exposure_spread=0.0)


@pytest.fixture(scope="module")
def instants():
    room = lit_room(TINY.seed)
    return [room.at(time_s) for time_s in (0.0, 0.4)]


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return write_demo(tmp_path_factory.mktemp("demo") / "room", TINY, workers=1)


@pytest.fixture(scope="module")
def cameras():
    return rig(seed=0, width=160, height=120, cameras_per_row=12)


def film(options, camera, instants):
    """The frames of one camera of the rig that shows the given instants."""
    shot = replace(rig_shots(options)[camera], instants=tuple(range(len(instants))))
    return list(Footage(options, shot, lambda index: instants[index]).frames())


def digests(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.proof)])
def test_same_options_give_same_bytes(demo, tmp_path, workers):
    """Two runs, in this process or in two others, write the same files with the same bytes."""
    again = write_demo(tmp_path / "again", TINY, workers=workers)
    assert digests(again) == digests(demo)


@pytest.mark.slow
def test_layout_is_dynerf(demo):
    """One video per pose row, rows in the order of the sorted names; exact depth, path and
    description beside them.
    """
    poses = np.load(demo / "poses_bounds.npy")
    videos = sorted(demo.glob("*.mp4"))
    assert [video.name for video in videos] == [f"cam{index:02d}.mp4" for index in range(4)]
    assert poses.shape == (4, 17)
    assert poses.dtype == np.float64
    assert {VideoFrames(video).n_frames for video in videos} == {3}
    assert np.load(demo / "path" / "poses_bounds.npy").shape == (2, 17)
    assert sorted(path.name for path in (demo / "path" / "images").iterdir()) == [
        "0000.png",
        "0001.png",
    ]
    assert json.loads((demo / "demo.json").read_text())["units_per_metre"] == UNITS_PER_METRE


@pytest.mark.slow
def test_poses_follow_llff(demo):
    """Read back by the LLFF rules, the rows are rotations with determinant +1 and the rig's
    cameras.
    """
    rows = np.load(demo / "poses_bounds.npy")
    for row, camera in zip(
        rows, rig(TINY.seed, TINY.width, TINY.height, TINY.cameras_per_row), strict=True
    ):
        down, right, back, centre, (height, width, focal) = row[:15].reshape(3, 5).T
        camera_to_world = np.stack([right, down, -back], axis=1)
        assert np.linalg.det(camera_to_world) == pytest.approx(1.0)
        np.testing.assert_allclose(camera_to_world.T, camera.rotation, atol=1e-12)
        np.testing.assert_allclose(centre, camera.centre, atol=1e-9)
        assert (height, width, focal) == (TINY.height, TINY.width, camera.focal_px)
        assert 0 < row[15] < row[16]


@pytest.mark.slow
def test_depth_file_holds_the_rendered_depth(demo):
    """The depth beside a video is the renderer's, bit for bit, and spans the noted range."""
    frames = film(TINY, 1, [lit_room(TINY.seed).at(index / TINY.fps) for index in range(2)])
    np.testing.assert_array_equal(read_exact_depth(demo, "cam01", 1), frames[1].depth)
    near, far = np.load(demo / "poses_bounds.npy")[1, 15:]
    np.testing.assert_allclose(np.percentile(frames[0].depth, [1, 99.9]), [near, far])
    with h5py.File(demo / "depth" / "cam01.h5") as file:
        assert file["depth"].shape == (3, 48, 64)
        assert file["depth"].chunks == (1, 48, 64)


def test_rig_is_like_the_real_one(cameras):
    """Two rows 2.75 units apart, about 1.1 units between neighbours, axes up to 30..40 degrees from
    cam00's in the middle.
    """
    order = [[*range(11, 6, -1), 0, *range(6, 0, -1)], list(range(23, 11, -1))]
    centres = np.stack([camera.centre for camera in cameras])
    for row in order:
        steps = np.diff(centres[row], axis=0)
        assert (steps[:, 0] > 0.5).all()
        assert (
            0.85 < np.linalg.norm(steps, axis=1).min() <= np.linalg.norm(steps, axis=1).max() < 1.4
        )
    assert centres[order[1], 1].mean() - centres[order[0], 1].mean() == pytest.approx(2.75, abs=0.1)
    angles = [np.degrees(np.arccos(camera.axis @ cameras[0].axis)) for camera in cameras[1:]]
    assert 30 < max(angles) < 40
    assert abs(cameras[0].centre[0]) < 0.2


@pytest.mark.slow
def test_depth_equals_closed_form_on_the_walls(cameras, instants):
    """No ray sees beyond the box of the room, and rays with nothing in their way end on it, as the
    slab formula says.
    """
    _, depth = render_view(instants[0], cameras[0], 1)
    rays = rays_in_room(cameras[0]).astype(np.float64).reshape(120, 160, 3)
    low, high = instants[0].static.bounds
    wall_m = np.where(rays > 0, high, low) - eye_in_room(cameras[0])
    box_depth = (wall_m / rays).min(axis=-1)
    assert (depth <= box_depth * 1.00001).all()
    assert (np.abs(depth / box_depth - 1) < 1e-5).mean() > 0.25


def reprojection(instant, source, target):
    """Picture of `target`, that of `source` where its points project, whether they lie inside, and
    their relative depth error.
    """
    image, depth = render_view(instant, target)
    other, other_depth = render_view(instant, source)
    points = target.unproject(target.pixel_centres(), depth.astype(np.float64))
    uv, z = source.project(points)
    column, row = (np.floor(uv[..., k]).astype(int) for k in (0, 1))
    inside = (column >= 0) & (column < source.width) & (row >= 0) & (row < source.height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    error = np.abs(other_depth[row, column] / z - 1)
    return image, other[row, column], inside, error


@pytest.mark.slow
def test_picture_and_depth_agree(cameras, instants):
    """What two neighbours both see has one colour, but for the rounding to pixels: above 25 dB."""
    image, other, inside, error = reprojection(instants[0], cameras[4], cameras[5])
    both = inside & (error < 0.01)
    psnr_db = -10 * np.log10(np.mean((image[both] - other[both]) ** 2))
    assert both.mean() > 0.6
    assert psnr_db > 25


@pytest.mark.slow
def test_something_moves_and_most_does_not(cameras, instants):
    """In 0.4 s some percent of the pixels change clearly, in colour and in depth, and most keep
    their depth exactly.
    """
    (image, depth), (later, later_depth) = (
        render_view(instant, cameras[0]) for instant in instants
    )
    assert 0.02 < (np.abs(later - image).max(axis=-1) > 0.1).mean() < 0.4
    assert 0.02 < (np.abs(later_depth - depth) > 0.5).mean() < 0.2
    assert (later_depth == depth).mean() > 0.8


def test_exposure_differs_between_cameras_only_when_wanted():
    """The gains of the cameras spread as told, and are exactly 1 without a spread."""
    many = DemoOptions(cameras_per_row=500, exposure_spread=0.1)
    assert camera_gains(many).mean(axis=1).std() == pytest.approx(
        0.1 * np.hypot(1, 0.5 / np.sqrt(3)), rel=0.1
    )
    assert (camera_gains(CLEAN) == 1).all()


@pytest.mark.proof
def test_rooms_of_the_tests_are_lit_as_all_rooms_are(instants):
    """The light that tests share on disk has the bits of light that is cast anew."""
    fresh = LitRoom(build_room(TINY.seed)).at(0.4)
    assert (fresh.static_light == instants[1].static_light).all()
    assert (fresh.moving_light == instants[1].moving_light).all()


def test_path_moves_along_the_image_rows(cameras):
    """The path keeps the orientation and moves along the camera's own x axis, so that a point keeps
    its image row.
    """
    path = sideways_path(cameras[0], 4.0, 5)
    uv = np.stack([camera.project(np.array([0.3, 0.2, 20.0]))[0] for camera in path])
    np.testing.assert_allclose(uv[:, 1], uv[0, 1])
    np.testing.assert_allclose(np.diff(uv[:, 0]), np.diff(uv[:, 0])[0])
    np.testing.assert_allclose(path[2].centre, cameras[0].centre, atol=1e-12)


@pytest.mark.slow
def test_a_written_demo_is_left_alone(demo):
    """Asked again for the same demo, nothing is written."""
    before = {path: path.stat().st_mtime_ns for path in demo.rglob("*")}
    assert write_demo(demo, TINY) == demo
    assert {path: path.stat().st_mtime_ns for path in demo.rglob("*")} == before


@pytest.mark.slow
def test_other_options_in_the_same_folder_are_refused(demo):
    """A folder with a demo of other options is not overwritten."""
    with pytest.raises(CaptureError, match="other options"):
        write_demo(demo, replace(TINY, seed=1))


def test_foreign_files_are_refused(tmp_path):
    """A folder with other files is not touched."""
    (tmp_path / "holiday.mp4").write_bytes(b"precious")
    with pytest.raises(CaptureError, match="found other files"):
        write_demo(tmp_path, TINY)
    assert [path.name for path in tmp_path.iterdir()] == ["holiday.mp4"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("width", 63),
        ("n_frames", 0),
        ("cameras_per_row", 1),
        ("noise_sigma_255", -1.0),
        ("fps", 0.0),
    ],
)
def test_impossible_options_are_refused(name, value):
    """An option that cannot be rendered is refused with its value."""
    with pytest.raises(CaptureError, match=f"got.* {value:g}"):
        replace(TINY, **{name: value})


@pytest.mark.slow
def test_missing_depth_says_what_to_do(demo):
    """Asking for depth that was not kept names the frames there are."""
    with pytest.raises(CaptureError, match=r"depth is kept of \[0, 1, 2\]"):
        read_exact_depth(demo, "cam00", 3)
