"""Cameras: projection and its inverse, resizing, cropping, refusal of nonsense."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ggvs_eval.camera import Camera, nearest_cameras, translated_path
from ggvs_eval.errors import CameraError
from helpers.refusals import refused


def make_camera(name="cam", seed=0, centre=None, width=64, height=48) -> Camera:
    random = np.random.default_rng(seed)
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    centre = random.normal(size=3) if centre is None else np.asarray(centre, float)
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ centre
    K = np.array([[70.0, 0, 31.0], [0, 72.0, 25.0], [0, 0, 1]])
    return Camera(name, K, world_to_camera, width, height, 1.0, 9.0)


def camera_pose(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation as OpenCV takes them."""
    return cv2.Rodrigues(camera.world_to_camera[:3, :3])[0], camera.world_to_camera[:3, 3]


@settings(deadline=None)
@given(seed=st.integers(0, 1000), depth=st.floats(0.1, 100))
def test_unproject_inverts_project(seed, depth):
    """A pixel lifted to any depth projects back onto itself with that depth."""
    camera = make_camera(seed=seed)
    uv = camera.pixel_centres()

    back, z = camera.project(camera.unproject(uv, np.full(uv.shape[:2], depth)))

    np.testing.assert_allclose(back, uv, atol=1e-8)
    np.testing.assert_allclose(z, depth, rtol=1e-9)
    points = camera.unproject(uv, np.full(uv.shape[:2], depth))
    by_opencv, _ = cv2.projectPoints(
        points.reshape(-1, 1, 3), *camera_pose(camera), camera.K_opencv, None
    )
    np.testing.assert_allclose(
        by_opencv.reshape(uv.shape), np.mgrid[:48, :64][::-1].transpose(1, 2, 0), atol=1e-6
    )


def test_rays_reach_every_depth():
    """Centre plus depth times ray is the unprojected point of that depth."""
    camera = make_camera()

    points = camera.centre + 4.0 * camera.rays()

    np.testing.assert_allclose(
        points, camera.unproject(camera.pixel_centres(), np.full((48, 64), 4.0)), atol=1e-12
    )


@settings(deadline=None)
@given(scale=st.sampled_from([(32, 96), (128, 24), (640, 480)]), seed=st.integers(0, 50))
def test_resizing_keeps_relative_position(scale, seed):
    """A point seen at a share of the image is seen at the same share of the resized image."""
    camera, points = make_camera(seed=seed), np.random.default_rng(seed).normal(size=(20, 3))

    uv, depth = camera.project(points)
    resized, _ = camera.resized(*scale).project(points)

    ahead = depth > 0.1
    np.testing.assert_allclose(resized[ahead] / scale, uv[ahead] / camera.size, atol=1e-9)


def test_cropping_shifts_pixels():
    """In a crop a point lies at its old position minus the crop's corner."""
    camera, point = (
        make_camera(seed=3),
        make_camera(seed=3).unproject(np.array([[20.5, 10.5]]), np.array([2.0])),
    )

    uv, _ = camera.cropped(5, 7, 30, 30).project(point)

    np.testing.assert_allclose(uv, [[15.5, 3.5]])


def test_nearest_cameras_leave_the_target_out_and_break_ties_by_name():
    """The target is never its own source; equally near cameras come in the order of their names."""
    rig = [
        make_camera(name, centre=(x, 0, 0)) for name, x in (("c", 1), ("a", 0), ("b", -1), ("d", 5))
    ]

    assert [camera.name for camera in nearest_cameras(rig[1], rig, 3)] == ["b", "c", "d"]
    with refused(CameraError, "4 source cameras", "has 3"):
        nearest_cameras(rig[1], rig, 4)


def test_path_moves_along_the_cameras_own_x_axis():
    """The middle of the path is the camera; its poses are equally spaced along x and never turn."""
    camera = make_camera(seed=2)

    path = translated_path(camera, 4.0, 5)

    offsets = np.stack([pose.centre - camera.centre for pose in path]) @ camera.rotation.T
    np.testing.assert_allclose(offsets, np.outer([-2, -1, 0, 1, 2], [1, 0, 0]), atol=1e-12)
    assert all(np.array_equal(pose.rotation, camera.rotation) for pose in path)


def nan_pose() -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = np.nan
    return pose


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"world_to_camera": nan_pose()}, "cam00: world_to_camera must be"),
        ({"world_to_camera": np.diag([1.0, 1, -1, 1])}, "determinant -1"),
        ({"K": np.diag([-1.0, 1, 1])}, "focal lengths must be positive"),
        ({"near": 5.0, "far": 2.0}, "0 < near < far"),
        ({"width": 0}, "size and focal lengths"),
    ],
)
def test_nonsense_is_refused_with_the_cameras_name(changes, message):
    """NaN, mirrored poses, negative focal lengths and empty ranges are refused in one line that
    names the camera.
    """
    values = {
        "K": np.diag([9.0, 9, 1]),
        "world_to_camera": np.eye(4),
        "width": 4,
        "height": 4,
        "near": 1.0,
        "far": 2.0,
    }

    with pytest.raises(CameraError, match=message) as caught:
        Camera("cam00", **(values | changes))

    assert "\n" not in str(caught.value)


def test_a_camera_goes_through_json_and_back():
    """Bit by bit; a record without one of the values is refused with the camera's name."""
    camera = make_camera("cam01", seed=3)
    record = json.loads(json.dumps(camera.to_json()))
    back = Camera.from_json("cam01", record)

    assert camera.shows_the_same_rays(back)
    assert (back.name, back.near, back.far) == ("cam01", camera.near, camera.far)
    with pytest.raises(CameraError, match=r"camera cam01: wanted K, .* got: 'near'"):
        Camera.from_json("cam01", {name: value for name, value in record.items() if name != "near"})
