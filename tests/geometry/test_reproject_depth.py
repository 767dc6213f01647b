"""Depth of a camera beside the colour camera, brought to its grid."""

import cv2
import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.reproject_depth import reproject_depth

WIDTH, HEIGHT = 96, 72


def make_camera(
    width: int, height: int, focal_px: float, position=(0.0, 0.0, 0.0), turn_rad=(0.0, 0.0, 0.0)
) -> Camera:
    """A camera at a place in the world, turned by a rotation vector."""
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = cv2.Rodrigues(np.array(turn_rad))[0]
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ position
    K = np.array([[focal_px, 0, width / 2 + 0.7], [0, focal_px, height / 2 - 1.3], [0, 0, 1]])
    return Camera("camera", K, world_to_camera, width, height, 0.1, 100.0)


def plane_depth(camera: Camera, normal, distance: float) -> np.ndarray:
    """Depth of the plane normal . X = distance, (H, W)."""
    return (distance - camera.centre @ normal) / (camera.rays() @ np.asarray(normal))


def seen_by(
    camera: Camera, target: Camera, truth: np.ndarray, margin_px: float = 1.0
) -> np.ndarray:
    """Pixels of the target whose surface lies in the camera's image, (H, W)."""
    uv, _ = camera.project(target.unproject(target.pixel_centres(), truth.astype(np.float64)))
    return (uv > margin_px).all(axis=-1) & (uv < np.array(camera.size) - margin_px).all(axis=-1)


@pytest.mark.parametrize("focal_px", [25.0, 80.0, 300.0])
def test_a_frontal_plane_keeps_its_depth_and_ends_where_the_sensor_does(focal_px):
    """A plane at 2 m is at 2 m wherever the sensor's frustum reaches, and unknown beyond: at any
    ratio of resolutions.
    """
    colour = make_camera(WIDTH, HEIGHT, 90.0)
    sensor = make_camera(40, 30, focal_px, position=(0.25, -0.1, 0.0))
    depth = reproject_depth(sensor, np.full((30, 40), 2.0), colour)
    left = 90 * (0.25 + 2 * (0 - sensor.K[0, 2]) / focal_px) / 2 + colour.K[0, 2]
    right = 90 * (0.25 + 2 * (40 - sensor.K[0, 2]) / focal_px) / 2 + colour.K[0, 2]
    top = 90 * (-0.1 + 2 * (0 - sensor.K[1, 2]) / focal_px) / 2 + colour.K[1, 2]
    bottom = 90 * (-0.1 + 2 * (30 - sensor.K[1, 2]) / focal_px) / 2 + colour.K[1, 2]
    u, v = np.moveaxis(colour.pixel_centres(), -1, 0)
    inside = (u > left) & (u < right) & (v > top) & (v < bottom)
    np.testing.assert_allclose(depth, np.where(inside, 2.0, 0.0), rtol=1e-6)
    assert inside.any()


def test_a_slanted_plane_stays_a_plane():
    """Pieces of plane go on as the plane does: no stairs from the sensor's coarser pixels, under
    any pose.
    """
    colour = make_camera(WIDTH, HEIGHT, 90.0)
    sensor = make_camera(48, 36, 40.0, position=(0.1, 0.05, -0.1), turn_rad=(0.02, -0.05, 0.03))
    normal = np.array([0.5, -0.3, 0.81])
    truth = plane_depth(colour, normal, 2.5)
    depth = reproject_depth(sensor, plane_depth(sensor, normal, 2.5), colour)
    seen = seen_by(sensor, colour, truth)
    assert seen.mean() > 0.5
    np.testing.assert_allclose(depth[seen], truth[seen], rtol=1e-5)


def test_the_same_camera_sees_what_was_measured():
    """Between equal cameras depth comes out as it went in, unknown pixels too."""
    camera = make_camera(WIDTH, HEIGHT, 90.0)
    depth = np.random.default_rng(1).uniform(0.5, 5.0, (HEIGHT, WIDTH)).astype(np.float32)
    depth[10:20, 30:50] = 0
    depth[0, 0] = np.nan
    np.testing.assert_allclose(
        reproject_depth(camera, depth, camera), np.nan_to_num(depth), rtol=1e-6
    )


def test_the_foreground_wins_and_what_the_sensor_does_not_see_is_unknown():
    """A board at 1 m before a wall at 3 m, seen from 0.2 m beside: it moves by 0.2 f (1 - 1/3)
    against the wall.
    """
    colour, sensor = (
        make_camera(WIDTH, HEIGHT, 90.0),
        make_camera(WIDTH, HEIGHT, 90.0, position=(0.2, 0.0, 0.0)),
    )
    measured = np.full((HEIGHT, WIDTH), 3.0)
    measured[20:50, 30:60] = 1.0
    depth = reproject_depth(sensor, measured, colour)
    expected = np.full((HEIGHT, WIDTH), 3.0)
    expected[:, :6] = 0  # 0.2 * 90 / 3 columns that the sensor does not see
    expected[20:50, 36:66] = 0  # the wall behind the board, 6 columns to the right of where it was
    expected[20:50, 48:78] = 1.0
    np.testing.assert_allclose(depth, expected, rtol=1e-6)


def test_a_point_far_nearer_than_the_others_is_no_hole_and_no_crash():
    """Points at the target's centre, behind it or out of its view are left out; an empty map stays
    empty.
    """
    colour, sensor = (
        make_camera(WIDTH, HEIGHT, 90.0),
        make_camera(40, 30, 40.0, position=(0.0, 0.0, -1.0)),
    )
    assert not reproject_depth(sensor, np.zeros((30, 40)), colour).any()
    assert not reproject_depth(sensor, np.full((30, 40), 0.5), colour).any()
    with pytest.raises(RenderError, match="depth must be 30 x 40"):
        reproject_depth(sensor, np.zeros((HEIGHT, WIDTH)), colour)
