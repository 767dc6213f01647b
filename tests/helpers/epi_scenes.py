"""Textured planes seen from a camera that moves sideways, rendered exactly: for measures of view
consistency.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ggvs_eval.camera import Camera, translated_path
from ggvs_eval.files.images import quantise
from ggvs_eval.metrics.path.rendered_path import PathPose

WIDTH, HEIGHT, FOCAL, POSES = 128, 32, 110.0, 25
SPAN = 0.9  # 0.0375 per pose: 1.0 to 1.6 px per pose on the planes below
RAYS = 4  # per pixel along x
SOURCE_EVERY = 0.25  # source cameras stand in a row along the path


@dataclass(frozen=True)
class Plane:
    """z = depth + slant * x + tilt * y, seen where |x| < half_width, with a texture of its own."""

    depth: float
    slant: float = 0.0
    tilt: float = 0.0
    half_width: float = np.inf
    seed: int = 0

    def hit(self, centre: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Distance along each ray, as a multiple of it, to the plane without its ends."""
        gradient = np.array([self.slant, self.tilt, -1.0])
        return -(self.depth + centre @ gradient) / (rays @ gradient)

    def seen(self, centre: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """The same, inf where a ray passes beside the plane's ends."""
        distance = self.hit(centre, rays)
        return np.where(
            np.abs(centre[0] + distance * rays[..., 0]) < self.half_width, distance, np.inf
        )

    def colour(self, points: np.ndarray) -> np.ndarray:
        """A sum of waves over world x and y, (..., 3) in [0, 1]; the finest has a period of about 9
        px.
        """
        random = np.random.default_rng([7, self.seed])
        waves = random.uniform(-1, 1, (16, 2)) * (17.0, 12.0)
        phases, mix = random.uniform(0, 2 * np.pi, 16), random.normal(0, 0.11, (16, 3))
        values = np.sin(points[..., :2] @ waves.T + phases) @ mix
        return np.clip(0.5 + values, 0.02, 0.98)


WALL = (Plane(4.0),)
SLANTED = (Plane(3.4, slant=0.35, tilt=0.4),)
TWO_PLANES = (Plane(4.0), Plane(2.6, half_width=0.35, seed=1))
SCENES = {"wall": WALL, "slanted": SLANTED, "two planes": TWO_PLANES}


def path(poses: int = POSES, span: float = SPAN) -> list[Camera]:
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return translated_path(Camera("middle", K, np.eye(4), WIDTH, HEIGHT, 2.0, 8.0), span, poses)


def sources_of(camera: Camera, count: int = 2) -> tuple[str, ...]:
    """Names of the nearest of the source cameras."""
    stands = np.arange(-3, 4) * SOURCE_EVERY + 0.03
    order = np.argsort(np.abs(stands - camera.centre[0]), kind="stable")[:count]
    return tuple(f"cam{index}" for index in order)


def look(
    planes: Sequence[Plane], camera: Camera, depth_factor: float = 1.0, source_x: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Image in [0, 1] and exact depth.

    With `depth_factor`, the image as a renderer makes it that takes its colours from a camera at
    `source_x` by a depth that is wrong by that factor: each pixel shows what the source sees in the
    direction of the wrong point.
    """
    fine = camera.resized(RAYS * camera.width, camera.height)
    rays = fine.rays()
    hits = _hits(planes, fine.centre, rays)
    depth, colour, source = hits.min(axis=0), np.zeros(rays.shape), np.array([source_x, 0.0, 0.0])
    for plane, mine in zip(
        planes, hits.argmin(axis=0)[None] == np.arange(len(planes))[:, None, None], strict=True
    ):
        points = fine.centre + depth_factor * depth[mine][:, None] * rays[mine]
        if depth_factor != 1:
            points = source + (points - source) * plane.hit(source, points - source)[:, None]
        colour[mine] = plane.colour(points)
    image = colour.reshape(camera.height, camera.width, RAYS, 3).mean(axis=2)
    return image, _hits(planes, camera.centre, camera.rays()).min(axis=0).astype(np.float32)


def _hits(planes: Sequence[Plane], centre: np.ndarray, rays: np.ndarray) -> np.ndarray:
    return np.stack([plane.seen(centre, rays) for plane in planes])


@lru_cache
def exact(name: str) -> tuple[PathPose, ...]:
    """The path through one of SCENES without any defect; nobody changes it."""
    return tuple(rendered(SCENES[name]))


def rendered(
    planes: Sequence[Plane],
    cameras: Sequence[Camera] | None = None,
    depth_factors: Sequence[float] | None = None,
    own_depth: bool = False,
) -> list[PathPose]:
    """The poses of a path, 8-bit.

    Args:
        planes: the scene.
        cameras: the path; `path()` if None.
        depth_factors: each pose is rendered with a depth wrong by its factor, from a source camera
            left of the path.
        own_depth: the poses carry that wrong depth, not the true one.
    """
    cameras = cameras or path()
    poses = []
    for index, camera in enumerate(cameras):
        factor = 1.0 if depth_factors is None else depth_factors[index]
        image, depth = look(planes, camera, factor, source_x=-0.8)
        poses.append(
            PathPose(
                camera,
                quantise(image),
                depth * np.float32(factor if own_depth else 1),
                sources_of(camera),
            )
        )
    return poses


def changed(
    poses: Sequence[PathPose], change: Callable[[int, np.ndarray], np.ndarray]
) -> list[PathPose]:
    """The same poses with other images: `change` takes the number of a pose and its image in [0,
    1], and may leave [0, 1].
    """
    return [
        replace(pose, image=quantise(change(index, pose.image / 255.0)))
        for index, pose in enumerate(poses)
    ]
