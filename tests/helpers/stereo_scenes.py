"""Textured surfaces seen by cameras that differ in place and direction, in closed form."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.images import quantise, write_image

WIDTH, HEIGHT, FOCAL = 200, 150, 170.0
NEAR, FAR = 4.0, 9.0
TEXELS_PER_UNIT = 40.0
PLANE = np.array([0.25, 0.15, 6.0])  # z = 0.25 x + 0.15 y + 6


def look_from(x: float, y: float, name: str, turn: float = 0.0) -> Camera:
    """A camera at (x, y, 0), turned by `turn` radians towards the middle of the scene."""
    turned, _ = cv2.Rodrigues(turn * np.array([-np.sign(y), np.sign(x), 0.0]))
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = turned
    world_to_camera[:3, 3] = -turned @ [x, y, 0.0]
    K = np.array([[FOCAL, 0.0, 97.3], [0.0, FOCAL * 1.01, 76.1], [0.0, 0.0, 1.0]])
    return Camera(name, K, world_to_camera, WIDTH, HEIGHT, NEAR, FAR)


@cache
def random_texture(seed: int = 0) -> np.ndarray:
    """Band-limited noise, (1024, 1024), in [0, 1]; made once, so it must not be written to."""
    noise = np.random.default_rng(seed).normal(size=(1024, 1024))
    fine, coarse = (cv2.GaussianBlur(noise, (0, 0), sigma) for sigma in (2.5, 10))
    texture = np.clip(0.5 + 0.12 * (fine / fine.std() + coarse / coarse.std()), 0, 1)
    texture.flags.writeable = False
    return texture


def plane_depth(camera: Camera, plane: np.ndarray = PLANE) -> np.ndarray:
    """Exact depth of the plane z = a x + b y + c, (H, W)."""
    rays = camera.rays()
    normal = np.array([-plane[0], -plane[1], 1.0])
    return (plane[2] - normal @ camera.centre) / (rays @ normal)


def paint(camera: Camera, depth: np.ndarray, texture: np.ndarray) -> Image8:
    """What a camera sees of a surface painted with the texture along z, (H, W, 3)."""
    texels = (
        camera.unproject(camera.pixel_centres(), depth)[..., :2] * TEXELS_PER_UNIT
        + np.array(texture.shape) / 2
    )
    grey = cv2.remap(
        texture, texels.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    return np.repeat(quantise(grey)[..., None], 3, axis=-1)


def see_plane(camera: Camera, plane: np.ndarray = PLANE, gain: float = 1.0) -> Image8:
    """The slanted plane as the camera sees it."""
    return quantise(paint(camera, plane_depth(camera, plane), random_texture()) / 255.0 * gain)


FIVE_PLACES = ((0, 0), (0.4, 0), (-0.4, 0), (0, 0.4), (0.8, 0))


def write_capture(
    folder: Path,
    n_frames: int = 3,
    step: float = 0.2,
    places: Sequence[tuple[float, float]] = FIVE_PLACES,
) -> Capture:
    """Cameras before a plane that comes nearer by `step` from frame to frame, as image folders on
    disk.
    """
    cameras = [look_from(x, y, f"cam{index:02d}") for index, (x, y) in enumerate(places)]
    for camera in cameras:
        for frame in range(n_frames):
            image = see_plane(camera, PLANE - [0, 0, step * frame])
            write_image(folder / camera.name / f"{frame:04d}.png", image)
    sources = tuple(ImageFrames(folder / camera.name) for camera in cameras)
    return Capture(
        "plane", "folders", folder, tuple(cameras), sources, n_frames, 30.0, 1.0, "known"
    )
