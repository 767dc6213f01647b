"""Rigs before textured surfaces in closed form, with features enough to be matched: a straight one,
and a dome.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.files.images import write_image
from helpers.small_layouts import camera_toml

# radii of the dome's wall, of the ball in its middle and of the cameras' ring
WALL_M, BALL_M, RING_M = 3.6, 0.7, 2.75
WALL_Z, BOX_Z = 30.0, 12.0  # of the straight rig


def straight_rig(count: int = 5, spacing: float = 0.8, turn_rad: float = 0.02) -> list[Camera]:
    """Cameras in a row that look nearly straight ahead at what is far: their axes meet where
    nothing is.
    """
    return [
        _camera(
            f"cam{i:02d}", (spacing * (i - (count - 1) / 2), 0.0, 0.0), turn_rad * ((i * 7) % 5 - 2)
        )
        for i in range(count)
    ]


def dome_rig(count: int = 14) -> list[Camera]:
    """Cameras on a ring that look at its middle, with 26 degrees between neighbours."""
    angles = 2 * np.pi * np.arange(count) / count
    return [
        _camera(f"cam{i:02d}", (RING_M * np.sin(a), 0.0, -RING_M * np.cos(a)), -a)
        for i, a in enumerate(angles)
    ]


def knocked(camera: Camera, rng: np.random.Generator, turn_rad: float, shift: float) -> Camera:
    """A camera whose pose is known with errors of these standard deviations."""
    pose = camera.world_to_camera.copy()
    pose[:3, :3] = Rotation.from_rotvec(turn_rad * rng.normal(size=3)).as_matrix() @ pose[:3, :3]
    pose[:3, 3] = -pose[:3, :3] @ (camera.centre + shift * rng.normal(size=3))
    return replace(camera, world_to_camera=pose)


def see_straight(camera: Camera) -> Image8:
    """A wall, and a box before its middle."""
    rays = camera.rays()
    wall, box = (
        camera.centre + (z - camera.centre[2]) / rays[..., 2:] * rays for z in (WALL_Z, BOX_Z)
    )
    is_box = (np.abs(box[..., 0]) < 3) & (np.abs(box[..., 1]) < 2.5)
    return _painted(
        np.where(is_box[..., None], box, wall) / np.where(is_box, BOX_Z, WALL_Z)[..., None], is_box
    )


def see_dome(camera: Camera) -> Image8:
    """A ball in the middle of a round wall."""
    rays = camera.rays()
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = rays @ camera.centre
    inside = along**2 - camera.centre @ camera.centre + BALL_M**2
    to_wall = -along + np.sqrt(along**2 - camera.centre @ camera.centre + WALL_M**2)
    distance = np.where(inside > 0, -along - np.sqrt(np.maximum(inside, 0)), to_wall)
    return _painted(camera.centre + distance[..., None] * rays, inside > 0)


def write_rig(folder: Path, cameras: Sequence[Camera], pictures: Sequence[Image8]) -> Path:
    """capture.toml without near and far, one picture per camera."""
    for camera, picture in zip(cameras, pictures, strict=True):
        write_image(folder / "images" / f"{camera.name}.png", picture)
    text = "".join(camera_toml(camera, f"images/{camera.name}.png") for camera in cameras)
    (folder / "capture.toml").write_text(text)
    return folder


def _camera(
    name: str, centre: Sequence[float], turn_rad: float, width: int = 240, height: int = 180
) -> Camera:
    K = np.array([[0.85 * width, 0, width / 2], [0, 0.85 * width, height / 2], [0, 0, 1.0]])
    pose = np.eye(4)
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    pose[:3, :3] = [[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]]
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(centre)
    return Camera(name, K, pose, width, height, 0.1, 100.0)


def _painted(points: Array, is_near: Array) -> Image8:
    """Spots of several sizes, fixed to the surface; (H, W, 3)."""
    image = np.zeros((*points.shape[:2], 3))
    for seed, scale in ((1, 9.0), (2, 17.0), (3, 31.0)):
        cells = (
            np.floor(points * scale + 50.0).astype(np.int64)
            @ np.array([73856093, 19349663, 83492791])
            + seed
        )
        image += (
            np.stack(
                [(cells * prime >> 7) % 97 / 96 for prime in (2654435761, 40503, 9973)], axis=-1
            )
            / 3
        )
    return np.asarray(
        np.clip(255 * np.where(is_near[..., None], 0.3 + 0.7 * image, 0.8 * image), 0, 255),
        np.uint8,
    )
