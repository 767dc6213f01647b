"""What a viewer is shown: sizes, layers, two methods beside each other, the history of a method,
and what it recorded.
"""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.contrib.view import viewer as listener_module
from ggvs_eval.contrib.view.live_view import LAYERS, FrameStock, LiveView, ViewRequest, fitted
from ggvs_eval.contrib.view.scene import cloud, gazed_depth
from ggvs_eval.contrib.view.session import Recording
from ggvs_eval.contrib.view.viewer import require_viser
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import CommandError, RenderError
from ggvs_eval.files.images import quantise
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.pipelines.play.playback import PlayOptions, playback_of_capture
from ggvs_eval.pipelines.play.synthesizer import OnlineSynthesizer
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.protocol import Frames, Measurement, Protocol, Synthesis, Views, load_protocol
from helpers.itermvs_weights import write_checkpoint
from helpers.refusals import refused
from helpers.stereo_scenes import HEIGHT, PLANE, WIDTH, plane_depth, write_capture

STEP = 0.2  # by which the plane comes nearer from instant to instant
ALL = 10**9  # pixels: as captured
METHOD = "ours-geometric"
PROTOCOL = Protocol(
    "plane", "plane", Views(("cam00",), "test"), Frames(0, 3), Synthesis(2), Measurement(("PSNR",))
)


@pytest.fixture
def stock(playback):
    return FrameStock(playback, ALL)


def request_of(playback, **changes) -> ViewRequest:
    """The middle camera's own pose at the first instant."""
    pose = replace(playback.capture.cameras[0], name="view")
    return replace(ViewRequest(pose, 0, (METHOD,), 2), **changes)


def test_every_camera_has_depth_at_every_instant(playback, stock):
    """A target may stand anywhere at any time; the depth is that of the plane."""
    for camera in playback.capture.cameras:
        for instant in playback.instants:
            image, found = stock.read(camera.name, instant)
            assert np.array_equal(image, playback.capture.frame(camera.name, instant))
            known = found.depth > 0
            assert known.mean() > 0.5
            exact = plane_depth(camera, PLANE - [0, 0, STEP * instant])
            assert np.median(np.abs(found.depth / exact - 1)[known]) < 0.02


def test_live_depth_is_found_at_the_size_that_is_shown(tmp_path):
    """A view without stored depth: the picture of OnlineSynthesizer without depth, and depth of a
    camera when it is asked for.
    """
    matcher = DepthRunOptions(f"itermvs:{write_checkpoint(tmp_path / 'model.ckpt')}").options(
        "cpu:0"
    )
    playback = playback_of_capture(
        write_capture(tmp_path, 1), PlayOptions(k=2), matcher, tmp_path / "cache", anywhere=True
    )
    small = FrameStock(playback, WIDTH * HEIGHT // 4)
    request = request_of(playback, methods=("distance-based",))
    picture = LiveView(small, 1.0, WIDTH * HEIGHT // 4, "cpu:0").picture(request)
    assert next(iter(picture.seconds["distance-based"])) == "depth"
    synthesizer = OnlineSynthesizer(small.cameras, 2, method="distance-based", depth=playback.live)
    target = fitted(request.pose, WIDTH * HEIGHT // 4)
    images = {name: small.image(name, 0) for name in synthesizer.needed(target)}
    np.testing.assert_array_equal(
        picture.image, quantise(synthesizer.step(images, None, target).image)
    )
    found = small.read("cam00", 0)[1]
    assert found.depth.shape == (HEIGHT // 2, WIDTH // 2)
    assert (found.depth > 0).all()
    assert not list((tmp_path / "cache").rglob("*.npz"))


def test_small_frames_keep_shape_and_surfaces(playback, stock):
    """Images shrink by the same factor on both sides; a depth that is shown is one that was
    there.
    """
    small = FrameStock(playback, WIDTH * HEIGHT // 4)
    image, found = small.read("cam01", 0)
    assert image.shape == (HEIGHT // 2, WIDTH // 2, 3)
    assert small.cameras[1].size == (WIDTH // 2, HEIGHT // 2)
    assert np.isin(found.depth, stock.read("cam01", 0)[1].depth).all()


def test_memory_is_bounded(playback):
    """As many frames are kept as the limit allows, but never less than one per camera."""
    tight = FrameStock(playback, ALL, memory=1)
    for camera in playback.capture.cameras:
        for instant in playback.instants:
            tight.read(camera.name, instant)
    assert tight.read.cache_info().currsize == len(playback.capture.cameras)


def test_a_picture_is_what_the_method_synthesises(playback, stock):
    """The same as the synthesizer says, whose interface is public."""
    request = request_of(playback)
    picture = LiveView(stock, 1.0, ALL).picture(request)
    synthesizer = OnlineSynthesizer(stock.cameras, 2, 1.0, METHOD)
    names = [camera.name for camera in synthesizer.sources(request.pose)]
    images, depths = ({name: stock.read(name, 0)[part] for name in names} for part in (0, 1))
    assert picture.sources == tuple(names)
    assert np.array_equal(
        picture.image, quantise(synthesizer.step(images, depths, request.pose).image)
    )
    assert picture.seconds[METHOD]["step"] > 0


def test_time_that_jumps_begins_anew(playback, stock):
    """Instants 0, 1, 2 build up a history; 2 after 0 is like 2 alone. At a camera's place its
    picture is shown.
    """
    view, between = LiveView(stock, 1.0, ALL), moved(request_of(playback).pose, 0.1)
    view.picture(request_of(playback, pose=between))
    jumped = view.picture(request_of(playback, pose=between, instant=2)).image
    alone = LiveView(stock, 1.0, ALL).picture(request_of(playback, pose=between, instant=2)).image
    history = LiveView(stock, 1.0, ALL)
    played = [
        history.picture(request_of(playback, pose=between, instant=instant)).image
        for instant in (0, 1, 2)
    ][-1]
    assert np.array_equal(jumped, alone)
    assert not np.array_equal(played, alone)


def moved(camera, along_x: float):
    world_to_camera = camera.world_to_camera.copy()
    world_to_camera[0, 3] -= along_x
    return replace(camera, world_to_camera=world_to_camera)


def test_outside_of_what_cameras_see_a_picture_fades(playback, stock):
    """Within the rig it is shown as the method made it; far beside it is greyer, and said to be
    outside, with the share seen.
    """
    view, request = LiveView(stock, 1.0, ALL), request_of(playback)
    inside = view.picture(request)
    assert (inside.is_outside, inside.faded is inside.image) == (False, True)
    outside = view.picture(replace(request, pose=moved(request.pose, 3.0)))
    farther = view.picture(replace(request, pose=moved(request.pose, 6.0)))
    assert outside.is_outside
    assert farther.seen_share < outside.seen_share < inside.seen_share
    grey = [
        np.abs(each.faded.astype(int) - 128).mean() / np.abs(each.image.astype(int) - 128).mean()
        for each in (outside, farther)
    ]
    assert grey[1] < grey[0] < 1


@pytest.mark.parametrize("layer", LAYERS)
def test_layers_have_the_size_of_the_picture(playback, stock, layer):
    """What the method decided is shown over the whole picture, and is another picture."""
    view = LiveView(stock, 1.0, ALL)
    image = view.picture(request_of(playback, methods=("ours",), layer=layer)).image
    assert image.shape == (HEIGHT, WIDTH, 3)
    shown = LiveView(stock, 1.0, ALL).picture(request_of(playback, methods=("ours",))).image
    assert np.array_equal(image, shown) == (layer == "picture")


def test_a_layer_that_a_method_lacks_is_an_error(playback, stock):
    """The message names what it has."""
    with refused(RenderError, "no-blending", "weights", "picture"):
        LiveView(stock, 1.0, ALL).picture(
            request_of(playback, methods=("no-blending",), layer="weights")
        )


def test_two_methods_meet_at_the_divider(playback, stock):
    """Left of the line the first alone, right of it the second alone."""
    both = (
        LiveView(stock, 1.0, ALL)
        .picture(request_of(playback, methods=(METHOD, "no-blending"), divider=0.25))
        .image
    )
    first, second = (
        LiveView(stock, 1.0, ALL).picture(request_of(playback, methods=(label,))).image
        for label in (METHOD, "no-blending")
    )
    column = WIDTH // 4
    assert np.array_equal(both[:, : column - 1], first[:, : column - 1])
    assert np.array_equal(both[:, column + 1 :], second[:, column + 1 :])


def test_points_lie_on_the_plane(playback, stock):
    """The cloud of an instant stands where the plane stands then, in the colours of the images."""
    points, colours = cloud(stock, 1, most=500)
    assert len(points) == len(colours) <= 1000
    a, b, c = PLANE - [0, 0, STEP]
    assert np.median(np.abs(points[:, 2] - (a * points[:, 0] + b * points[:, 1] + c))) < 0.05
    assert gazed_depth(stock, 1) == pytest.approx(c, rel=0.05)


def recording_of(playback, folder) -> Recording:
    """Three requests of a camera that moves while time plays."""
    view = playback.capture.cameras[0]
    recording = Recording(playback, view, PROTOCOL, folder, "cpu")
    recording.toggle()
    for instant in (0, 1, 2):
        pose = np.eye(4)
        pose[0, 3] = -0.05 * instant
        recording.append(
            request_of(
                playback, instant=instant, pose=replace(view, name="view", world_to_camera=pose)
            )
        )
    recording.toggle()
    recording.append(request_of(playback))  # after the end
    return recording


def test_a_recorded_path_becomes_a_video(playback, tmp_path):
    """Three frames of the rig's size; a second one does not overwrite the first."""
    recording = recording_of(playback, tmp_path)
    assert recording.write_video() == f"3 frames by {METHOD} in {tmp_path / 'path000.mp4'}"
    recording.write_video()
    assert VideoFrames(tmp_path / "path001.mp4").n_frames == 3
    assert next(VideoFrames(tmp_path / "path000.mp4").frames(0, 1)).shape == (HEIGHT, WIDTH, 3)


def test_a_recorded_path_becomes_a_protocol(playback, tmp_path):
    """A run under it has the recorded poses, at the instant at which the recording began."""
    message = recording_of(playback, tmp_path).write_protocol()
    protocol = load_protocol(tmp_path / "path000.toml")
    assert f"--protocol {tmp_path / 'path000.toml'}" in message
    plan = plan_run(RunRequest(tmp_path / "run", playback.capture, protocol, ()))
    assert [round(float(pose.target.centre[0]), 6) for pose in plan.path] == [0, 0.05, 0.1]
    assert plan.path_frame == 0
    assert plan.path[0].target.size == (WIDTH, HEIGHT)


def test_without_viser_one_line_says_what_to_install(monkeypatch):
    """Before anything is computed."""
    monkeypatch.setattr(listener_module.importlib.util, "find_spec", lambda _: None)
    with refused(CommandError, "pip install 'ggvs-eval[view]'"):
        require_viser()
