"""Points on the surfaces of the room and which camera sees which of them: what structure from motion finds, without error."""

import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.datasets.colmap_writer import Sightings
from ggvs_eval.synthetic.film.film import lit_room
from ggvs_eval.synthetic.film.options import DemoOptions
from ggvs_eval.synthetic.film.raycast import depth_along
from ggvs_eval.synthetic.film.rig import directions_in_room, eye_in_room, room_from_world, room_to_world
from ggvs_eval.synthetic.film.shots import rig_of
from ggvs_eval.synthetic.room.lighting import Instant

POINTS = 600
# What ends a ray before this share of its way to a point hides the point.
REACHED = 0.9998


def surface_points(options: DemoOptions) -> Array:
    """Points on what never moves, as many from the view of each camera of the rig, world units, (P, 3)."""
    static, cameras = lit_room(options.seed, options.scene).static, rig_of(options)
    rng = np.random.default_rng([options.seed, 10])
    points = []
    for camera in cameras:
        uv = rng.uniform(0, 1, (-(-POINTS // len(cameras)), 2)) * camera.size
        rays = directions_in_room(camera, (uv - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]])
        hits = static.cast(eye_in_room(camera), rays)
        points_m = eye_in_room(camera) + hits.distance[:, None] * rays[hits.ray]
        points.append(room_to_world(points_m))
    return np.concatenate(points)


def sightings(points: Array, camera: Camera, instant: Instant, image: Image8) -> Sightings:
    """The points that a camera sees at an instant: inside its picture and nothing before them.

    Args:
        points: world units, (P, 3).
        camera: the true one.
        instant: the room.
        image: of the camera at that instant.
    """
    uv, depth = camera.project(points)
    inside = (depth > 0) & (uv >= 0).all(axis=1) & (uv < camera.size).all(axis=1)
    eye = eye_in_room(camera)
    towards: Array32 = (room_from_world(points) - eye).astype(np.float32)
    static, moving = instant.static, instant.moving
    seen = inside & (depth_along(static, eye, towards) > REACHED)
    if moving is not None:
        seen &= depth_along(moving, eye, towards) > REACHED
    index = np.flatnonzero(seen)
    column, row = np.floor(uv[index]).astype(int).T
    return Sightings(index, uv[index], image[row, column])
