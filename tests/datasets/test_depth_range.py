"""Depth ranges for cameras whose capture gives none."""

import numpy as np
import pytest

from ggvs_eval.datasets.depth_range import points_depth_range, read_points, rig_depth_range
from ggvs_eval.errors import CaptureError
from helpers.refusals import refused

K = np.array([[50.0, 0.0, 32.0], [0.0, 50.0, 24.0], [0.0, 0.0, 1.0]])


def looking_at(centre, target) -> np.ndarray:
    """world_to_camera of a camera at `centre` whose optical axis goes through `target`; y
    is down.
    """
    forwards = np.subtract(target, centre) / np.linalg.norm(np.subtract(target, centre))
    right = np.cross([0.0, 1.0, 0.0], forwards)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forwards, right), forwards]
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(centre, float)
    return pose


def ring(count: int, radius: float = 4.0) -> list[np.ndarray]:
    angles = 2 * np.pi * np.arange(count) / count
    return [
        looking_at((radius * np.sin(a), -0.5, radius * np.cos(a)), (0.0, 0.0, 0.0)) for a in angles
    ]


@pytest.mark.parametrize("count", [2, 3, 4, 12])
def test_cameras_around_a_scene(count):
    """Cameras that look inwards from all sides, however few, get 1/4 and 4 times the distance to
    what they look at.
    """
    distance = np.hypot(4.0, 0.5)
    assert rig_depth_range(ring(count)) == [pytest.approx((distance / 4, 4 * distance))] * count


def test_cameras_in_an_arc():
    """Each camera's range goes with its own distance."""
    centres = [(-2.0, 0.0, 0.0), (0.0, 0.0, -3.0), (2.0, 0.0, 0.0)]
    found = rig_depth_range([looking_at(centre, (0.0, 0.0, 8.0)) for centre in centres])
    expected = [np.hypot(2, 8), 11.0, np.hypot(2, 8)]
    assert found == [pytest.approx((depth / 4, 4 * depth)) for depth in expected]


@pytest.mark.parametrize(
    ("place", "target"), [((4.0, 0.0, 4.0), (8.0, 0.0, 8.0)), ((60.0, 0.0, 0.0), (0.0, 0.0, 0.0))]
)
def test_a_camera_that_looks_elsewhere_gets_the_range_of_the_others(place, target):
    """One camera that looks away does not get a negative depth, one that stands far off no depth of
    its own.
    """
    away = looking_at(place, target)
    ranges = rig_depth_range([*ring(8), away])
    assert ranges[-1] == pytest.approx(np.median(ranges[:-1], axis=0), rel=0.1)
    assert all(0 < near < far for near, far in ranges)


@pytest.mark.parametrize("rig", ["parallel", "outwards", "skew"])
def test_rigs_that_look_at_no_common_point(rig):
    """Parallel, diverging and unrelated axes get 5 and 500 times the spacing of the cameras."""
    centres = [(0.2 * index, 0.0, 0.0) for index in range(5)]
    targets = {
        "parallel": [(x, 0.0, 9.0) for x, _, _ in centres],
        "outwards": [(0.4 + 9.0 * (x - 0.4), 0.0, 1.0) for x, _, _ in centres],
        "skew": [
            (x + 0.1 * (-1) ** index, 0.5 * (-1) ** (index // 2), 1.0)
            for index, (x, _, _) in enumerate(centres)
        ],
    }
    poses = [
        looking_at(centre, target) for centre, target in zip(centres, targets[rig], strict=True)
    ]
    assert rig_depth_range(poses) == [pytest.approx((1.0, 100.0))] * 5


def test_one_camera_and_cameras_in_one_place():
    """Without a baseline there is nothing to measure."""
    one = looking_at((1.0, 2.0, 3.0), (0.0, 0.0, 9.0))
    assert rig_depth_range([one]) == [(0.1, 100.0)]
    assert rig_depth_range([one, one]) == [(0.1, 100.0)] * 2


def test_poses_that_are_none_raise_nothing():
    """NaN and numbers beyond all measure are left to the camera's own check."""
    spoilt = np.eye(4)
    spoilt[0, 3] = np.nan
    huge = np.eye(4)
    huge[0, 3] = 1e300
    assert (
        rig_depth_range([np.eye(4), spoilt])
        == rig_depth_range([np.eye(4), huge])
        == [(0.1, 100.0)] * 2
    )


def test_depth_of_points_in_view():
    """Only points in front of the camera and inside the image count; percentiles 1, 50 and 99.9."""
    pose = np.eye(4)
    pose[2, 3] = 1.0  # the camera stands at z = -1
    in_view = np.stack([np.zeros(101), np.zeros(101), np.linspace(-0.5, 9.5, 101)], axis=-1)
    # the last one at v = 60
    others = np.array([[0.0, 0.0, -50.0], [30.0, 0.0, 3.0], [0.0, -30.0, 3.0], [0.0, 0.36, -0.5]])
    found = points_depth_range(np.concatenate([in_view, others]), pose, K, (64, 48))
    assert found == pytest.approx((0.6, 5.5, 10.49), abs=1e-9)
    assert points_depth_range(others, pose, K, (64, 48)) is None


@pytest.mark.parametrize("binary", [False, True])
def test_points_of_a_ply_file(tmp_path, binary):
    """Vertices come back from text and binary files, whatever else they carry."""
    points = np.random.default_rng(1).normal(size=(20, 3)).astype("<f4")
    header = f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\nelement vertex 20\n"
    header += (
        "property float x\nproperty float y\nproperty float z\nproperty uchar red\nend_header\n"
    )
    file = tmp_path / "background.ply"
    if binary:
        rows = np.empty(20, [("xyz", "<f4", 3), ("red", "u1")])
        rows["xyz"], rows["red"] = points, 7
        file.write_bytes(header.encode() + rows.tobytes())
    else:
        file.write_text(header + "".join(f"{x:.9g} {y:.9g} {z:.9g} 7\n" for x, y, z in points))
    np.testing.assert_allclose(read_points(file), points, atol=1e-7)


HEADER = (
    "ply\nformat ascii 1.0\n{}element vertex {}\nproperty float x\nproperty float y\nproperty "
    "float z\nend_header\n{}"
)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no ply at all",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty double "
        b"x\nend_header\n123",
        HEADER.format("", 2, "1 2 3\n1 nan 3\n").encode(),
        HEADER.format("", 0, "").encode(),
        HEADER.format("", 3, "1 2\n").encode(),
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n",
    ],
    ids=["empty", "text", "claims too much", "NaN", "no point", "too short", "no end"],
)
def test_damaged_ply_files(tmp_path, content):
    """What is no cloud of finite points is refused in one line that names the file."""
    file = tmp_path / "background.ply"
    file.write_bytes(content)
    with refused(CaptureError, "background.ply", "restore it") as caught:
        read_points(file)
    assert "\n" not in str(caught.value)


def test_a_texture_that_a_ply_file_names_is_not_opened(tmp_path, monkeypatch):
    """A file may name any other as its texture; nothing of it is read."""
    from PIL import Image

    opened = []
    monkeypatch.setattr(Image, "open", lambda *args, **kwargs: opened.append(args))
    (tmp_path / "secret.png").write_bytes(b"x")
    file = tmp_path / "background.ply"
    file.write_text(HEADER.format("comment TextureFile secret.png\n", 1, "1 2 3\n"))
    assert read_points(file).tolist() == [[1.0, 2.0, 3.0]]
    assert opened == []
