"""Footage for fits: pictures and depth of a cloud of Gaussians that is known at every time."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch

from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap, DepthStore
from ggvs_eval.files.images import quantise
from ggvs_eval.gaussians import GaussianCloud, render_gaussians
from ggvs_eval.scene_fitter import Footage

WIDTH, HEIGHT = 64, 48


class StoredFrames:
    """Frames of one camera that lie in memory."""

    def __init__(self, frames: np.ndarray) -> None:
        self._frames = frames

    @property
    def n_frames(self) -> int:
        """How many."""
        return len(self._frames)

    @property
    def digest(self) -> str:
        """Of nobody's interest here."""
        return "in memory"

    def frames(self, start: int, stop: int) -> Iterator[np.ndarray]:
        """Yield some of them."""
        yield from self._frames[start:stop]


def rig(count: int = 6) -> tuple[Camera, ...]:
    """Cameras on a short arc before the origin, which they look at, 4 units away."""
    cameras = []
    for place in range(count):
        angle = 0.5 * (place / max(1, count - 1) - 0.5)
        height = 0.25 if place % 2 else -0.25
        centre = np.array([4 * np.sin(angle), height, -4 * np.cos(angle)])
        forward = -centre / np.linalg.norm(centre)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = right, np.cross(forward, right), forward
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ centre
        K = np.array([[60.0, 0, WIDTH / 2], [0, 60.0, HEIGHT / 2], [0, 0, 1]])
        cameras.append(Camera(f"cam{place:02d}", K, world_to_camera, WIDTH, HEIGHT, 2.0, 8.0))
    return tuple(cameras)


def wall(
    across: int = 20, down: int = 15, colours: np.ndarray | None = None, scale: float = 0.16
) -> GaussianCloud:
    """A wall of opaque Gaussians, wider than what the cameras of `rig` see of it; its middle stands
    out.

    Args:
        across: how many side by side.
        down: how many rows.
        colours: of each, (across x down, 3); smooth ones by default.
        scale: their standard deviation.
    """
    random = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-2.6, 2.6, across), np.linspace(-2.0, 2.0, down))
    depth = np.where(x**2 + y**2 < 0.5, -0.6, 0.0)
    places = np.stack([x, y, depth], axis=-1).reshape(-1, 3) + random.normal(
        0, 0.02, (across * down, 3)
    )
    waves = np.stack(
        [np.sin(3 * x + y), np.sin(2 * y - 2 * x + 1), np.cos(2 * x + 3 * y)], axis=-1
    ).reshape(-1, 3)
    paint = 0.5 + 0.35 * waves if colours is None else colours
    means, painted = (torch.as_tensor(values, dtype=torch.float32) for values in (places, paint))
    return GaussianCloud.of_points(means, painted, scale=scale, opacity=0.9, degree=1)


def footage_of(
    cloud_at: Callable[[float], GaussianCloud],
    folder: Path,
    instants: int = 4,
    cameras: tuple[Camera, ...] | None = None,
) -> Footage:
    """Pictures and depth of a cloud, at times from 0 to 1.

    Args:
        cloud_at: time -> the cloud.
        folder: gets the depth.
        instants: how many.
        cameras: the rig's by default.
    """
    cameras = cameras or rig()
    store = DepthStore(folder)
    frames = {camera.name: [] for camera in cameras}
    for index in range(instants):
        cloud = cloud_at(index / max(1, instants - 1))
        for camera in cameras:
            with torch.no_grad():
                picture = render_gaussians(cloud, camera)
            frames[camera.name].append(quantise(picture.image.clamp(max=1).numpy()))
            depth = np.where(picture.alpha.numpy() > 0.5, picture.depth.numpy(), 0).astype(
                np.float32
            )
            store.write(camera.name, index, DepthMap(depth, (depth > 0).astype(np.float32)))
    sources = {name: StoredFrames(np.stack(images)) for name, images in frames.items()}
    keys = {camera.name: camera.name for camera in cameras}
    return Footage(
        cameras, range(instants), 30.0 if instants > 1 else 0.0, 1.0, 0, sources, keys, store
    )
