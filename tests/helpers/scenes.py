"""A wall with a square floating before it, in closed form: image and exact depth of any camera at
any time.
"""

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.raycast import View
from ggvs_eval.contrib.worlds.room.lighting import Instant as RoomInstant
from ggvs_eval.files.images import quantise
from ggvs_eval.method import Instant, SourceView

WALL_Z, SQUARE_Z, SQUARE_HALF = 5.0, 3.5, 0.5
WIDTH, HEIGHT, FOCAL = 96, 72, 90.0


def camera_at(
    x: float, y: float = 0.0, name: str | None = None, width: int = WIDTH, height: int = HEIGHT
) -> Camera:
    """A camera at (x, y, 0) that looks along z."""
    K = np.array([[FOCAL, 0, width / 2], [0, FOCAL, height / 2], [0, 0, 1]])
    world_to_camera = np.eye(4)
    world_to_camera[:2, 3] = -x, -y
    return Camera(name or f"x{x:+.2f}", K, world_to_camera, width, height, 2.0, 8.0)


def texture(points_world: np.ndarray, phase: float) -> np.ndarray:
    """A smooth colour pattern over world x and y, (..., 3), in [0, 1]."""
    x, y = points_world[..., 0] + phase, points_world[..., 1]
    waves = np.stack([np.sin(4 * x + y), np.sin(3 * y - 2 * x + 1), np.cos(2 * x + 3 * y)], axis=-1)
    return 0.5 + 0.35 * waves


def look(camera: Camera, square_x: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Image (H, W, 3) uint8 and exact depth (H, W) float32; the square's centre is at (square_x,
    0).
    """
    rays = camera.rays()
    on_square = camera.centre + SQUARE_Z * rays
    hit = (np.abs(on_square[..., 0] - square_x) < SQUARE_HALF) & (
        np.abs(on_square[..., 1]) < SQUARE_HALF
    )
    wall = texture(camera.centre + WALL_Z * rays, 0.0)
    square = texture(on_square - [square_x, 0, 0], 2.0)[..., ::-1]
    image = np.where(hit[..., None], square, wall)
    return quantise(image), np.where(hit, SQUARE_Z, WALL_Z).astype(np.float32)


def instant(
    index: int,
    target: Camera,
    sources: list[Camera],
    square_x: float = 0.0,
    depth_noise: float = 0.0,
    seed: int = 0,
) -> Instant:
    """What a method is shown, with exact depth or with Gaussian noise on it."""
    random = np.random.default_rng([seed, index])
    views = []
    for camera in sources:
        image, depth = look(camera, square_x)
        depth = (
            depth + random.normal(0, depth_noise, depth.shape).astype(np.float32)
            if depth_noise
            else depth
        )
        views.append(SourceView(camera, image, depth, np.ones_like(depth)))
    return Instant(index, target, tuple(views), units_per_metre=2.5)


def render_view(
    instant: RoomInstant, camera: Camera, supersampling: int = 2
) -> tuple[np.ndarray, np.ndarray]:
    """One picture of the lit demo room: image, sRGB in [0, 1], (H, W, 3), and depth, world units,
    (H, W).
    """
    picture = View(instant.static, camera, supersampling).render(instant)
    return picture.image, picture.depth
