"""Play: the way of the virtual camera, a video of it from a capture and from a run folder, and what
cannot be played.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.camera import Camera, translated_path
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import GgvsError
from ggvs_eval.files.images import quantise
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.pipelines.play.play import Timing, record
from ggvs_eval.pipelines.play.playback import (
    PlayOptions,
    blocks_of,
    camera_loop,
    playback_of_capture,
    playback_of_run,
)
from ggvs_eval.pipelines.play.synthesizer import OnlineSynthesizer, seen_share
from ggvs_eval.pipelines.run.prepare import prepare
from ggvs_eval.protocol import CameraPath, Frames, Measurement, Protocol, Synthesis, Views
from helpers.command_line import refusal
from helpers.itermvs_weights import write_checkpoint
from helpers.stereo_scenes import HEIGHT, WIDTH, plane_depth, see_plane, write_capture

DEPTH = DepthRunOptions("sgbm").options()


@pytest.fixture(scope="module")
def nearing_plane(tmp_path_factory):
    """Five cameras before a plane that comes nearer, three instants."""
    return write_capture(tmp_path_factory.mktemp("plane"))


def facing(centre: tuple[float, float, float], towards: np.ndarray, name: str) -> Camera:
    """A camera that looks at a point, upright."""
    axis = np.array(towards) - centre
    axis = axis / np.linalg.norm(axis)
    right = np.cross([0.0, 1.0, 0.0], axis)
    right /= np.linalg.norm(right)
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = [right, np.cross(axis, right), axis]
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ centre
    return Camera(
        name, np.array([[90.0, 0, 48], [0, 90, 36], [0, 0, 1]]), world_to_camera, 96, 72, 1.0, 9.0
    )


def rig(shape: str) -> tuple[list[Camera], np.ndarray]:
    """Cameras in two rows, in one row, or on a whole circle, and the point that all look at."""
    middle = np.array([0.0, 0.0, 4.0])
    if shape == "circle":
        angles = 2 * np.pi * np.arange(16) / 16
        centres = [(4 * np.sin(angle), 0.0, 4 - 4 * np.cos(angle)) for angle in angles]
    else:
        centres = [
            (x, y, 0.0)
            for y in ((0.0,) if shape == "row" else (-0.3, 0.3))
            for x in np.linspace(-1.2, 1.2, 7)
        ]
    return [
        facing(centre, middle, f"cam{index:02d}") for index, centre in enumerate(centres)
    ], middle


@pytest.mark.parametrize("shape", ["rows", "row", "circle"])
def test_the_way_is_closed_smooth_and_within_the_rig(shape):
    """No step, nor the one from the last pose to the first, is much longer than the others; no pose
    leaves the rig's box.
    """
    cameras, middle = rig(shape)
    poses = camera_loop(cameras, 60)
    centres = np.stack([pose.centre for pose in poses])
    steps = np.linalg.norm(np.roll(centres, -1, axis=0) - centres, axis=1)
    box = np.stack([camera.centre for camera in cameras])
    assert steps.max() < 2.5 * steps.mean()
    assert (centres >= box.min(axis=0) - 1e-9).all()
    assert (centres <= box.max(axis=0) + 1e-9).all()
    assert np.ptp(centres[:, 0]) > 0.4 * np.ptp(box[:, 0])
    for pose in poses:
        off_axis = np.cross(middle - pose.centre, pose.axis)
        assert np.linalg.norm(off_axis) < 0.1 * np.linalg.norm(middle - pose.centre)
        assert pose.rotation[1, 1] > 0.95  # upright


def test_the_view_of_the_way_fits_a_video():
    """The size of the rig's images made even, or the width that is wanted, with the rig's depth
    range and names of its own.
    """
    cameras, _ = rig("rows")
    odd = [camera.cropped(0, 0, 95, 71) for camera in cameras]
    assert camera_loop(odd, 1)[0].size == (94, 70)
    (small,) = camera_loop(cameras, 1, width=48)
    assert small.size == (48, 36)
    assert (small.near, small.far, small.name) == (1.0, 9.0, "pose0000")
    assert small.K[0, 0] == pytest.approx(45.0)


def test_blocks_cover_what_is_needed():
    """Every instant with its cameras lies in one block, blocks do not overlap and name no more
    cameras than allowed.
    """
    needed = {t: {f"cam{(t // 3 + i) % 9}" for i in range(2)} for t in range(5, 40)}
    blocks = list(blocks_of(needed, 4))
    assert [t for block, _ in blocks for t in block] == list(needed)
    assert all(needed[t] <= names for block, names in blocks for t in block)
    assert all(len(names) <= 4 for _, names in blocks)
    assert len(blocks) < len(needed) / 4


def test_times_are_percentiles_without_the_first_frame():
    """Closed form: 10, 20, ... ms after a slow first frame; a stage that comes later in a sequence
    is counted where it is.
    """
    rows = [{"read": 9.0, "splat": 9.0, "synthesis": 9.0, "encode": 9.0}]
    rows += [
        {"read": 0.001, "splat": 0.01 * t, "synthesis": 0.02 * t, "encode": 0.004}
        for t in range(1, 12)
    ]
    timing = Timing(rows)
    assert timing.milliseconds()["splat"] == pytest.approx((60.0, 105.0))
    assert timing.milliseconds()["synthesis"] == pytest.approx((120.0, 210.0))
    assert "8.33 frames per second of synthesis, 8.00 with reading and encoding" in timing.table()


@pytest.mark.slow
def test_a_capture_is_played(nearing_plane, tmp_path):
    """The video shows what a camera on the way would see; every step is timed; a second playback
    finds frames and depth there.
    """
    options = PlayOptions(k=2, frames=3)
    playback = playback_of_capture(nearing_plane, options, DEPTH, tmp_path / "cache")
    timing = record(playback, tmp_path / "out.mp4")

    video = VideoFrames(tmp_path / "out.mp4")
    assert (video.n_frames, video.size, video.fps) == (3, (WIDTH, HEIGHT), 30.0)
    for t, (image, pose) in enumerate(zip(video.frames(0, 3), playback.poses, strict=True)):
        truth = see_plane(pose, np.array([0.25, 0.15, 6.0 - 0.2 * t]))
        error = np.abs(image.astype(float) - truth)[20:-20, 20:-20]
        assert np.median(error) < 6, f"frame {t}"
    assert timing.milliseconds().keys() == {
        "read",
        "filter",
        "splat",
        "tsdf",
        "blend",
        "synthesis",
        "encode",
    }

    kept = {file: file.stat().st_mtime_ns for file in (tmp_path / "cache").rglob("*.npz")}
    assert len(kept) < 5 * 3  # not all depth there could be
    again = playback_of_capture(nearing_plane, options, DEPTH, tmp_path / "cache")
    assert {file: file.stat().st_mtime_ns for file in (tmp_path / "cache").rglob("*.npz")} == kept
    assert again.depth_keys == playback.depth_keys


@pytest.mark.slow
def test_the_video_is_what_the_synthesizer_gives(nearing_plane, tmp_path):
    """Each frame is a step of OnlineSynthesizer, but for the encoder's loss."""
    playback = playback_of_capture(
        nearing_plane, PlayOptions(k=2, frames=2, width=120), DEPTH, tmp_path / "cache"
    )
    record(playback, tmp_path / "out.mp4")
    live = OnlineSynthesizer(playback.capture.cameras, 2)
    for t, image in enumerate(VideoFrames(tmp_path / "out.mp4").frames(0, 2)):
        names = [camera.name for camera in live.sources(playback.poses[t])]
        images = {name: nearing_plane.frame(name, t) for name in names}
        depths = {name: playback.store.read(playback.depth_keys[name], t).depth for name in names}
        assert (
            np.abs(
                depths[names[0]] / (plane_depth(nearing_plane.camera(names[0])) - 0.2 * t) - 1
            ).mean()
            < 0.1
        )
        expected = quantise(live.step(images, depths, playback.poses[t]).image)
        assert np.abs(image.astype(float) - expected).mean() < 4


@pytest.mark.slow
def test_depth_of_a_network_on_a_device_is_found_as_pictures_are_shown(nearing_plane, tmp_path):
    """Nothing is stored before; each frame is a step of OnlineSynthesizer without depth. ``cpu:0``
    goes the GPU's way.
    """
    matcher = DepthRunOptions(f"itermvs:{write_checkpoint(tmp_path / 'model.ckpt')}")
    options = PlayOptions(k=2, frames=2, width=120)
    playback = playback_of_capture(
        nearing_plane, options, matcher.options("cpu:0"), tmp_path / "cache"
    )
    timing = record(playback, tmp_path / "out.mp4", "distance-based", "cpu:0")
    assert not list((tmp_path / "cache").rglob("*.npz"))
    assert list(timing.rows[0])[:2] == ["read", "depth"]
    live = OnlineSynthesizer(
        playback.capture.cameras, 2, method="distance-based", depth=playback.live
    )
    for t, image in enumerate(VideoFrames(tmp_path / "out.mp4").frames(0, 2)):
        images = {name: nearing_plane.frame(name, t) for name in live.needed(playback.poses[t])}
        expected = quantise(live.step(images, None, playback.poses[t]).image)
        assert np.abs(image.astype(float) - expected).mean() < 4
    assert (
        playback_of_capture(nearing_plane, options, matcher.options(), tmp_path / "cache").live
        is None
    )


def test_a_run_is_played_without_new_depth(nearing_plane, tmp_path):
    """Frames and depth of a prepared run are taken; cameras without depth there are no sources."""
    protocol = Protocol(
        "tiny",
        "plane",
        Views(("cam00",), "by hand"),
        Frames(1, 2),
        Synthesis(k=2),
        Measurement(metrics=("PSNR",)),
        CameraPath(poses=0),
    )
    prepared = prepare(tmp_path / "run", nearing_plane, protocol, depth=DepthRunOptions("sgbm"))
    before = set((tmp_path / "run").rglob("*"))

    playback = playback_of_run(prepared, PlayOptions())
    record(playback, tmp_path / "out.mp4")

    assert VideoFrames(tmp_path / "out.mp4").n_frames == 2
    assert list(playback.instants) == [1, 2]
    assert (playback.k, set(playback.capture.camera_names)) == (
        2,
        set(prepared.plans["cam00"].depth_keys),
    )
    assert set((tmp_path / "run").rglob("*")) == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (PlayOptions(frames=9), "wanted 9 frames to play, got 3; reduce --frames"),
        (PlayOptions(frames=0), "wanted at least 1 frame to play, got 0"),
        (PlayOptions(k=6), "wanted 6 source views, 5 cameras have depth"),
        (PlayOptions(k=0), "wanted 0 source views"),
        (PlayOptions(width=1), "wanted a view of at least 2 pixels across, got 1"),
    ],
)
def test_more_than_there_is_cannot_be_played(nearing_plane, tmp_path, options, words):
    """Said before anything is computed."""
    with pytest.raises(GgvsError, match=words):
        playback_of_capture(nearing_plane, options, DEPTH, tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_a_truncated_capture_is_one_line(dynerf, tmp_path):
    """Half a video is named, and nothing is left where the video would be."""
    video = sorted(dynerf.glob("*.mp4"))[2]
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])

    assert video.name in refusal("play", dynerf, tmp_path / "out.mp4")
    assert list(tmp_path.glob("out*")) == []


@pytest.mark.parametrize("place", ["file.txt/out.mp4", "folder.mp4", "out.avi"])
def test_a_video_that_cannot_be_written_is_one_line(dynerf, tmp_path, place):
    """Below a file, in place of a folder, under another suffix: refused before the capture is
    touched.
    """
    (tmp_path / "file.txt").write_text("x")
    (tmp_path / "folder.mp4").mkdir()

    message = refusal("play", dynerf, tmp_path / place)

    assert Path(place).name in message
    assert "cannot be written" in message or "wanted a video file to write" in message
    assert list(tmp_path.glob("*-cache")) == []


def test_frames_outside_of_what_the_cameras_see_are_counted():
    """The table of a film has one line more where some of its views are guessed at their rims, and
    none where none is.
    """
    rows = [{"read": 0.1, "synthesis": 0.2, "encode": 0.1}] * 3
    assert "outside" not in Timing(rows, [1.0, 0.9, 0.85]).table()
    assert "2 of 3 frames are outside" in Timing(rows, [1.0, 0.3, 0.5]).table()


def test_a_view_is_seen_as_far_as_cameras_stand_around_it():
    """Between the cameras all of it, beside them ever less, turned away nothing."""
    middle = facing((0.0, 0.0, 0.0), np.array([0.0, 0.0, 4.0]), "middle")
    rig = translated_path(middle, span=0.4, count=5)
    shares = [
        seen_share(replace(pose, name="view"), rig)
        for pose in translated_path(middle, span=4.0, count=5)[2:]
    ]
    assert shares[0] > 0.9
    assert shares[0] > shares[1] > shares[2]
    turned = replace(middle, name="view", world_to_camera=np.diag([-1.0, 1.0, -1.0, 1.0]))
    assert seen_share(turned, rig) == 0.0
