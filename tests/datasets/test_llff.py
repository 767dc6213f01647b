"""LLFF pose files: axes as the convention has them, and exactly what was written."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ggvs_eval.datasets.llff import LlffPose, read_llff_poses, write_llff_poses


def test_identity_pose(tmp_path):
    """A camera at the origin that looks along z has the axes down, right, backwards of the LLFF
    convention.
    """
    write_llff_poses(
        tmp_path / "poses_bounds.npy", [LlffPose(np.eye(4), (48.0, 64.0, 50.0), 1.0, 9.0)]
    )
    row = np.load(tmp_path / "poses_bounds.npy")[0]
    np.testing.assert_array_equal(
        row[:15].reshape(3, 5).T, [[0, 1, 0], [1, 0, 0], [0, 0, -1], [0, 0, 0], [48, 64, 50]]
    )
    np.testing.assert_array_equal(row[15:], [1, 9])


@settings(deadline=None)
@given(
    angles=st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    centre=st.lists(st.floats(-100, 100), min_size=3, max_size=3),
    focal=st.floats(1, 1e4),
    near=st.floats(1e-3, 10),
)
def test_round_trip(tmp_path_factory, angles, centre, focal, near):
    """Any rigid pose is read back as it was written, with determinant +1."""
    path = tmp_path_factory.mktemp("poses") / "poses_bounds.npy"
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = Rotation.from_rotvec(angles).as_matrix()
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ centre
    write_llff_poses(path, [LlffPose(world_to_camera, (1014.0, 1352.0, focal), near, 20.0)])
    (read,) = read_llff_poses(path)
    np.testing.assert_allclose(read.world_to_camera, world_to_camera, atol=1e-10)
    assert np.linalg.det(read.world_to_camera[:3, :3]) == pytest.approx(1.0)
    assert (read.hwf, read.near, read.far) == ((1014.0, 1352.0, focal), near, 20.0)
