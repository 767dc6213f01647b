"""Sensor depth that lies off its colour: measured in pixels, mended by what the images tell, left alone where it fits."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets import open_capture
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.inspection.capture.depth_range import check_depth_registration
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.offline.depth.fill_store import depth_job
from ggvs_eval.pipelines.offline.sensor.registered_capture import displacement
from ggvs_eval.pipelines.offline.sensor.registration import Registration, pose_after, with_registration
from ggvs_eval.protocol import CameraPath, Frames, Measurement, Protocol, Synthesis, Views
from helpers.lit_rooms import light_by_few_rays

WIDTH, HEIGHT = 240, 180


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    """Twelve frames of a hand-held camera in a validation room."""
    options = DemoOptions(layout="rgbd", seed=101, width=WIDTH, height=HEIGHT, n_frames=12, fps=10)
    with pytest.MonkeyPatch.context() as patch:
        light_by_few_rays(patch, tmp_path_factory.mktemp("light"))  # where depth lies does not depend on the light
        return write_demo(tmp_path_factory.mktemp("registration") / "room", options, workers=1)


def planted(room: Path, folder: Path, right_px: float, down_px: float, roll_deg: float, scale: float) -> Path:
    """The room with the depth maps moved, turned about their middle, and multiplied; pixels are the colour's."""
    shutil.copytree(room, folder)
    cosine, sine = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    turn = np.array([[cosine, -sine], [sine, cosine]])
    for file in (folder / "depth").iterdir():
        steps = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        size = np.array(steps.shape[::-1])
        middle = (size - 1) / 2
        shift = middle - turn @ middle + np.array([right_px, down_px]) * size[0] / WIDTH
        moved = cv2.warpAffine(steps, np.c_[turn, shift], size.tolist(), flags=cv2.INTER_NEAREST)
        cv2.imwrite(str(file), np.rint(moved * scale).astype(np.uint16))
    return folder


def depth_of(capture, index: int) -> np.ndarray:
    return next(iter(capture.extras_of(capture.cameras[index].name).depth.depths(0, 1)))


@pytest.mark.slow
def test_depth_that_fits_is_left_alone(room):
    """Of the room as it was rendered nothing is mended, and the check has nothing against it."""
    capture = open_capture(room)
    measured = displacement(capture)
    assert measured.applied == Registration()
    assert measured.displacement_px < 0.5
    assert abs(measured.registration.scale - 1) < 0.004
    assert with_registration(capture, measured.applied) is capture
    (finding,) = check_depth_registration(capture)
    assert (finding.verdict, finding.advice) == ("ok", "")
    name, estimated = capture.camera_names[0], DepthRunOptions(registration="estimated").options()
    assert depth_job(capture, name, (), estimated).spec == depth_job(capture, name, (), DepthOptions()).spec


@pytest.mark.slow
@pytest.mark.parametrize(("right_px", "down_px", "roll_deg", "scale"), [(4, -2, 0, 1), (-2, 3, 0.8, 1.04)])
def test_planted_errors_are_recovered(room, tmp_path, right_px, down_px, roll_deg, scale):
    """Offsets come back within half a pixel, a roll within 0.2 degrees, a scale within 0.5 %; mended depth is nearly the true."""
    capture = open_capture(planted(room, tmp_path / "planted", right_px, down_px, roll_deg, scale))
    measured = displacement(capture)
    applied = measured.applied
    back = -np.array([applied.right, applied.down]) * WIDTH
    turn = np.radians(roll_deg)
    expected = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ (right_px, down_px)
    np.testing.assert_allclose(back, expected, atol=0.5)
    assert np.degrees(applied.roll_rad) == pytest.approx(-roll_deg, abs=0.2)
    assert applied.scale == pytest.approx(1 / scale, abs=0.005)
    assert measured.psnr_db[1] > measured.psnr_db[0] + 1
    (finding,) = check_depth_registration(capture)
    assert finding.verdict == "bad"
    assert "--registration estimated corrects it" in finding.advice
    truth = depth_of(open_capture(room), 5)
    given, mended = (depth_of(each, 5) for each in (capture, with_registration(capture, applied)))
    wrong = [np.mean(np.abs(each / truth - 1)[10:-10, 10:-10] > 0.03) for each in (given, mended)]
    assert wrong[1] < 0.5 * wrong[0]
    spec = depth_job(capture, capture.camera_names[0], (), DepthRunOptions(registration="estimated").options()).spec
    assert spec["options"]["registration"]["scale"] == applied.scale


@pytest.mark.slow
def test_the_command_line_asks_for_it(room, tmp_path):
    """`--registration estimated` prepares mended depth, says so beside it, and keeps the choice."""
    capture = planted(room, tmp_path / "planted", 4, -2, 0, 1)
    target = open_capture(capture).camera_names[5]
    protocol = tmp_path / "one.toml"
    views, measured = Views((target,), "by hand"), Measurement(("PSNR",), ceilings=False)
    protocol.write_text(Protocol("one", "room", views, Frames(0, 1), Synthesis(1), measured, CameraPath(0)).to_toml())
    arguments = [
        "prepare",
        tmp_path / "run",
        "--capture",
        capture,
        "--protocol",
        protocol,
        "--registration",
        "estimated",
        "--jobs",
        1,
    ]
    run_command([str(each) for each in arguments])
    (spec,) = (json.loads(file.read_text()) for file in (tmp_path / "run" / "depth").glob("*/spec.json"))
    assert spec["options"]["registration"]["right"] * WIDTH == pytest.approx(-4, abs=0.5)
    assert json.loads((tmp_path / "run" / "depth.json").read_text())["registration"] == "estimated"


def make_camera(x: float = 0.0) -> Camera:
    world_to_camera = np.eye(4)
    world_to_camera[0, 3] = -x
    K = np.array([[100.0, 0, 40], [0, 100.0, 30], [0, 0, 1]])
    return Camera(f"{x:g}", K, world_to_camera, 80, 60, 0.1, 100.0)


def test_an_offset_moves_depth_by_whole_pixels():
    """A board moved 3 pixels right and 2 down, of a sensor with every pixel twice, is where it belongs; scale multiplies."""
    depth = np.kron(np.full((30, 40), 4.0, np.float32), np.ones((2, 2), np.float32))
    depth[20:40, 30:50] = 1.0
    camera = make_camera()
    moved = Registration(right=4 / 80, down=2 / 80, scale=1.5).apply(depth, camera, camera.world_to_camera)
    expected = np.zeros((60, 80))
    expected[2:, 4:] = 6.0
    expected[22:42, 34:54] = 1.5
    np.testing.assert_allclose(moved, expected, rtol=1e-6)


def test_a_roll_turns_depth_from_right_to_down():
    """A quarter turn takes what lies to the right of the principal point below it."""
    depth = np.zeros((60, 80), np.float32)
    depth[28:32, 58:62] = 2.0
    camera = make_camera()
    turned = Registration(roll_rad=np.pi / 2).apply(depth, camera, camera.world_to_camera)
    rows, columns = np.nonzero(turned)
    assert (rows.mean() + 0.5, columns.mean() + 0.5) == pytest.approx((50, 40), abs=0.6)


def test_a_delay_is_a_share_of_the_motion():
    """Between frames the camera moves at a constant speed, past the last one it goes on."""
    cameras = tuple(make_camera(x) for x in (0.0, 0.1, 0.4))
    for index, frames, x in ((0, 0.5, 0.05), (1, 0.5, 0.25), (1, -0.5, 0.05), (2, 0.5, 0.55), (0, -1.0, -0.1)):
        assert -pose_after(cameras, index, frames)[0, 3] == pytest.approx(x)
    assert replace(cameras[1], world_to_camera=pose_after(cameras, 1, 0.0)).centre[0] == pytest.approx(0.1)
