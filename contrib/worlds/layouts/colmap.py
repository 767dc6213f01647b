"""COLMAP's layout: ``sparse/0`` as text with true points, and a video per camera; a true camera path beside them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import PARTS, Footage, lit_room
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import depth_along
from ggvs_eval.contrib.worlds.film.rig import directions_in_room, eye_in_room, room_from_world, room_to_world
from ggvs_eval.contrib.worlds.film.shots import rig_of
from ggvs_eval.contrib.worlds.layouts.dynerf import split_path, write_film, write_path_poses
from ggvs_eval.contrib.worlds.room.lighting import Instant
from ggvs_eval.datasets.colmap_model import FILES, Sightings, write_model

POINTS = 600
# What ends a ray before this share of its way to a point hides the point.
REACHED = 0.9998
MODEL = "sparse/0"
LEAST_VIEWS = 2


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
    """
    uv, depth = camera.project(points)
    inside = (depth > 0) & (uv >= 0).all(axis=1) & (uv < camera.size).all(axis=1)
    eye = eye_in_room(camera)
    towards: Array32 = (room_from_world(points) - eye).astype(np.float32)
    static, moving = instant.static, instant.moving
    is_visible = inside & (depth_along(static, eye, towards) > REACHED)
    if moving is not None:
        is_visible &= depth_along(moving, eye, towards) > REACHED
    index = np.flatnonzero(is_visible)
    column, row = np.floor(uv[index]).astype(int).T
    return Sightings(index, uv[index], image[row, column])


def write_shot(folder: Path, footage: Footage) -> Camera:
    """Write ``camXX.mp4`` with its exact depth and its sightings, or one image of the path; gives the camera to note."""
    if footage.shot.sensor is not None:
        points, image = surface_points(footage.options), next(footage.frames()).image
        camera_sightings = sightings(points, footage.shot.camera, footage.instant(0), image)
        np.savez(_part(folder, footage.shot.camera), **camera_sightings._asdict())
    return write_film(folder, footage)


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``sparse/0/{cameras,images,points3D}.txt`` and the poses of the path.

    Reading:
        Sightings are those of the true cameras at the first frame; only the cameras are written down with an error. Points that
        a single camera sees are left out, as it could not triangulate them.
    """
    on_rig, on_path = split_path(options, cameras)
    points = surface_points(options)
    by_camera = [_read_part(folder, camera) for camera in on_rig]
    views = np.bincount(np.concatenate([sights.point for sights in by_camera]), minlength=len(points))
    kept = [sights.rows(views[sights.point] >= LEAST_VIEWS) for sights in by_camera]
    write_model(folder / MODEL, on_rig, kept, points)
    write_path_poses(folder, on_path)


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [*(f"{MODEL}/{name}" for name in FILES), *(f"{name}.mp4" for name in options.camera_names)]


def _part(folder: Path, camera: Camera) -> Path:
    return folder / PARTS / f"{camera.name}.npz"


def _read_part(folder: Path, camera: Camera) -> Sightings:
    with np.load(_part(folder, camera)) as stored:
        return Sightings(stored["point"], stored["uv"], stored["rgb"])
