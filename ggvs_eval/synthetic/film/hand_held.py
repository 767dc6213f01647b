"""A camera carried by hand through the volume that the rig spans, looking at the middle of the scene."""

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.synthetic.film.rig import AIM_M, ROW_GAP, intrinsics, room_to_world

# Half the extent of the motion along x, y and z, world units, and how often it swings per second.
REACH = np.array([4.0, 1.0, 0.7])
SWINGS_HZ = np.array([0.25, 0.37, 0.31])
AIM_SWAY, ROLL_RAD = 0.8, 0.03


def hand_held_poses(
    seed: int,
    width: int,
    height: int,
    count: int,
    fps: float,
    near: float = 1.0,
    far: float = 100.0,
    later_s: float = 0.0,
    sway: float = 1.0,
    spacing: float = 1.0,
) -> list[Camera]:
    """Poses along a smooth walk at up to 0.7 m/s between the two rows of the rig, called ``0``, ``1``, ...

    Args:
        seed: chooses where the walk begins.
        width: pixels.
        height: pixels.
        count: number of poses.
        fps: poses per second.
        near: depth range to note, world units.
        far: as near.
        later_s: every pose is that of so many seconds later.
        sway: factor on how far the camera looks about.
        spacing: factor on how far it is carried.
    """
    phase = np.random.default_rng([seed, 8]).uniform(0, 2 * np.pi, (2, 3))
    aim = room_to_world(np.array(AIM_M, np.float32))
    poses = []
    for index in range(count):
        turn = 2 * np.pi * SWINGS_HZ * (index + later_s * fps) / fps
        centre = np.array([0.0, ROW_GAP / 2, 0.0]) + spacing * REACH * np.sin(turn + phase[0])
        target = aim + sway * AIM_SWAY * np.sin(0.7 * turn + phase[1])
        pose = _look_at(centre, target, ROLL_RAD * float(np.sin(turn[0] + phase[1, 0])))
        poses.append(Camera(str(index), intrinsics(width, height), pose, width, height, near, far))
    return poses


def _look_at(centre: Array, target: Array, roll_rad: float) -> Array:
    """World to camera, (4, 4), from a centre towards a target; the world's y points down."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross((0.0, 1.0, 0.0), forward)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(roll_rad), np.sin(roll_rad)
    pose = np.eye(4)
    pose[:3, :3] = [cosine * right + sine * down, cosine * down - sine * right, forward]
    pose[:3, 3] = -pose[:3, :3] @ centre
    return pose
