"""Bringing one calibration into the world of another: similarities from centres and from whole
poses.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggvs_eval.errors import CameraError
from ggvs_eval.geometry.alignment import align_similarity, pose_differences
from helpers.captures import make_rig


def test_alignment_recovers_a_similarity():
    """Centres moved by a known similarity are brought back exactly, and a mirrored rig is not
    turned into a mirrored camera.
    """
    rng = np.random.default_rng(0)
    points, rotation = rng.normal(size=(7, 3)), Rotation.from_rotvec([0.3, -1.1, 0.4]).as_matrix()
    similarity = align_similarity(points, 2.5 * points @ rotation.T + [1.0, -2.0, 0.5])
    assert similarity.scale == pytest.approx(2.5)
    np.testing.assert_allclose(similarity.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(similarity.translation, [1.0, -2.0, 0.5], atol=1e-12)
    mirrored = align_similarity(points, points * [1, 1, -1])
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1)
    flat = align_similarity(points * [1, 1, 0], (points * [1, 1, 0]) @ rotation.T)
    np.testing.assert_allclose(flat.rotation, rotation, atol=1e-12)


def test_pose_differences_are_measured():
    """One camera turned by a degree about its centre differs by that degree and by no distance; too
    few cameras are refused.
    """
    truth = {camera.name: camera for camera in make_rig(("a", "b", "c", "d"))}
    moved = truth["c"].world_to_camera.copy()
    moved[:3, 3] -= moved[:3, :3] @ [0.0, 0.4, 0.2]  # off the line of the others
    truth["c"] = replace(truth["c"], world_to_camera=moved)
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec([0, np.radians(1), 0]).as_matrix()
    estimated = truth | {
        "b": replace(truth["b"], world_to_camera=turned @ truth["b"].world_to_camera)
    }
    distances, angles_rad = pose_differences(estimated, truth)
    np.testing.assert_allclose(distances, 0, atol=1e-9)
    np.testing.assert_allclose(np.degrees(angles_rad), [0, 1, 0, 0], atol=1e-6)
    with pytest.raises(CameraError, match="3 or more common cameras"):
        pose_differences({"a": truth["a"]}, truth)


def test_centres_on_a_line_leave_a_rotation_open():
    """Cameras in a straight row cannot be aligned by their centres."""
    points = np.outer(np.arange(4.0), [1.0, 2.0, 3.0])
    with pytest.raises(CameraError, match="off a line"):
        align_similarity(points, points)
