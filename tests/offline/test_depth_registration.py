"""Sensor depth that lies off its colour is moved, turned, scaled and delayed."""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.pipelines.offline.sensor.registration import Registration, pose_after


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
