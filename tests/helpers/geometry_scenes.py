"""Random small scenes for the geometric kernels: cameras around a rough surface, off-centre and of
different sizes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.tsdf import PreviousDepth, fusion_weights
from ggvs_eval.method import SourceView

TAU = 0.05

seeds = st.integers(0, 2**32 - 1)
sizes = st.tuples(st.integers(1, 40), st.integers(1, 30))


def random_camera(
    random: np.random.Generator, width: int, height: int, name: str = "camera"
) -> Camera:
    """A camera near the origin that looks roughly along z, its principal point off the centre."""
    focal = 1.1 * max(width, height, 12)
    K = np.array(
        [
            [focal, 0, width / 2 + random.normal()],
            [0, focal * 1.05, height / 2 + random.normal()],
            [0, 0, 1],
        ]
    )
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = Rotation.from_rotvec(random.normal(0, 0.03, 3)).as_matrix()
    world_to_camera[:3, 3] = random.normal(0, 0.08, 3)
    return Camera(name, K, world_to_camera, width, height, 0.8, 4.0)


def moved(camera: Camera, x: float, y: float = 0.0) -> Camera:
    """The same camera `x` to its right and `y` down."""
    world_to_camera = camera.world_to_camera.copy()
    world_to_camera[:2, 3] -= x, y
    return replace(camera, world_to_camera=world_to_camera)


def random_depth(random: np.random.Generator, camera: Camera, noise: float = 0.003) -> np.ndarray:
    """A tilted wall at z = 2, a box before it, noise and a few invalid pixels."""
    rays = camera.rays()
    normal = np.array([0.2, -0.1, 1.0])
    wall = (2.0 - camera.centre @ normal) / (rays @ normal)
    box = camera.centre + 1.5 * rays
    depth = np.where((np.abs(box[..., 0]) < 0.25) & (np.abs(box[..., 1]) < 0.2), 1.5, wall)
    depth = depth + random.normal(0, noise, depth.shape)
    depth[random.random(depth.shape) < 0.03] = 0.0
    return depth.astype(np.float32)


def view_of(camera: Camera, depth: np.ndarray, image: np.ndarray) -> SourceView:
    """A source view whose depth is trusted; its image may have any features that are splatted."""
    return SourceView(camera, image, depth, np.ones_like(depth))


def random_source(random: np.random.Generator, camera: Camera, channels: int) -> SourceView:
    """A source view with random features."""
    features = random.random((camera.height, camera.width, channels), dtype=np.float32)
    return view_of(camera, random_depth(random, camera), features)


# a camera, its depth and the weight of each pixel
WeightedDepth = tuple[Camera, np.ndarray, np.ndarray]


def columns(views: Sequence[WeightedDepth]) -> tuple[Sequence, ...]:
    """Cameras, depths and weights of views as a ray march takes them."""
    return tuple(zip(*views, strict=True)) or ((), (), ())


def random_views(
    random: np.random.Generator, size: tuple[int, int], count: int
) -> list[WeightedDepth]:
    """Cameras with depth and the weights that it is fused by."""
    views = []
    for _ in range(count):
        camera = random_camera(random, *size)
        depth = random_depth(random, camera)
        views.append((camera, depth, fusion_weights(depth, TAU, 0.002)))
    return views


def random_previous(random: np.random.Generator, target: Camera) -> PreviousDepth:
    """A previous depth seen from a pose 2 cm away, with gains on both sides of the limit."""
    camera = moved(target, -0.02, 0.013)
    shape = (target.height, target.width)
    accumulated = random.uniform(0, 8, shape).astype(np.float32)
    gain = random.uniform(0, 4, shape).astype(np.float32)
    return PreviousDepth(camera, random_depth(random, camera), accumulated, gain, 15.0)


def image8(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    """A random picture, RGB uint8."""
    return random.integers(0, 256, (height, width, 3)).astype(np.uint8)


def weighted_views(
    random: np.random.Generator, count: int, size: tuple[int, int]
) -> tuple[list[SourceView], list[float]]:
    """Source views and what each counts."""
    cameras = [random_camera(random, *size, name=f"cam{n}") for n in range(count)]
    views = [
        view_of(camera, random_depth(random, camera), image8(random, camera.height, camera.width))
        for camera in cameras
    ]
    return views, random.uniform(0.1, 1, count).tolist()
