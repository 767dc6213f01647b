"""Layouts of videos: DyNeRF's and COLMAP's with a true camera path, MeetRoom's, Google
Immersive's.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import PARTS, Footage, lit_room
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import (
    UNITS_PER_METRE,
    depth_along,
    directions_in_room,
    eye_in_room,
    in_metres,
    room_from_world,
    room_to_world,
)
from ggvs_eval.contrib.worlds.film.shots import fisheye_shots, rig_of
from ggvs_eval.contrib.worlds.room.lighting import Instant
from ggvs_eval.datasets.depth_range import DEPTH_RANGE_FILE, write_depth_range
from ggvs_eval.datasets.google_light_fields import MODELS
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.files.colmap_text import FILES, Sightings, write_model
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.kernels.portable import rotation_vector

POSES = "poses_bounds.npy"


def write_dynerf(folder: Path, footage: Footage) -> Camera:
    """Write ``camXX.mp4`` with its exact depth, or one image of the path.

    Gives the camera to note.
    """
    camera = footage.noted_camera()
    if footage.shot.sensor is None:
        write_image(folder / "path" / "images" / f"{camera.name}.png", next(footage.frames()).image)
    else:
        images = (frame.image for frame in footage.frames_keeping_depth(folder))
        write_video(folder / f"{camera.name}.mp4", images, footage.options.fps, footage.options.crf)
    return camera


def finish_dynerf(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``poses_bounds.npy`` of the rig and of the path."""
    on_rig, on_path = split_path(options, cameras)
    write_llff_poses(folder / POSES, [llff_pose(camera) for camera in on_rig])
    write_path_poses(folder, on_path)


def split_path(
    options: DemoOptions, cameras: Sequence[Camera]
) -> tuple[Sequence[Camera], Sequence[Camera]]:
    """Return the cameras of the rig and those of the path."""
    count = len(options.camera_names)
    return cameras[:count], cameras[count:]


def write_path_poses(folder: Path, cameras: Sequence[Camera]) -> None:
    """Write ``path/poses_bounds.npy``, if there is a path."""
    if cameras:
        write_llff_poses(folder / "path" / POSES, [llff_pose(camera) for camera in cameras])


def dynerf_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [POSES, *(f"{name}.mp4" for name in options.camera_names)]


POINTS = 600
# What ends a ray before this share of its way to a point hides the point.
REACHED = 0.9998
MODEL = "sparse/0"
LEAST_VIEWS = 2


def surface_points(options: DemoOptions) -> Array:
    """Return the points on what never moves, as many from the view of each camera of the rig, world
    units, (P, 3).
    """
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
    """Return the points that a camera sees at an instant: inside its picture and nothing before
    them.

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


def write_colmap(folder: Path, footage: Footage) -> Camera:
    """Write ``camXX.mp4`` with its exact depth and its sightings, or one image of the path.

    Gives the camera to note.
    """
    if footage.shot.sensor is not None:
        points, image = surface_points(footage.options), next(footage.frames()).image
        camera_sightings = sightings(points, footage.shot.camera, footage.instant(0), image)
        np.savez(_sightings_part(folder, footage.shot.camera), **camera_sightings._asdict())
    return write_dynerf(folder, footage)


def finish_colmap(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``sparse/0/{cameras,images,points3D}.txt`` and the poses of the path.

    Reading:
        Sightings are those of the true cameras at the first frame; only the cameras are written
        down with an error. Points that a single camera sees are left out, as it could not
        triangulate them.
    """
    on_rig, on_path = split_path(options, cameras)
    points = surface_points(options)
    by_camera = [_read_part(folder, camera) for camera in on_rig]
    views = np.bincount(
        np.concatenate([sights.point for sights in by_camera]), minlength=len(points)
    )
    sightings = [sights.rows(views[sights.point] >= LEAST_VIEWS) for sights in by_camera]
    write_model(folder / MODEL, on_rig, sightings, points)
    write_path_poses(folder, on_path)


def colmap_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [
        *(f"{MODEL}/{name}" for name in FILES),
        *(f"{name}.mp4" for name in options.camera_names),
    ]


def _sightings_part(folder: Path, camera: Camera) -> Path:
    return folder / PARTS / f"{camera.name}.npz"


def _read_part(folder: Path, camera: Camera) -> Sightings:
    with np.load(_sightings_part(folder, camera)) as stored:
        return Sightings(stored["point"], stored["uv"], stored["rgb"])


def write_meetroom(folder: Path, footage: Footage) -> Camera:
    """Write ``cam_<N>.mp4`` and its exact depth; gives the camera to note."""
    options = footage.options
    images = (frame.image for frame in footage.frames_keeping_depth(folder))
    write_video(folder / _video(footage.shot.camera.name), images, options.fps, options.crf)
    return footage.noted_camera()


def finish_meetroom(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``poses_bounds.npy``."""
    write_llff_poses(folder / POSES, [llff_pose(camera) for camera in cameras])


def meetroom_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [POSES, *map(_video, options.camera_names)]


def _video(name: str) -> str:
    return f"cam_{int(name.removeprefix('cam'))}.mp4"


def write_immersive(folder: Path, footage: Footage) -> Camera:
    """Write the fisheye video of one camera and its exact depth, which is undistorted.

    Gives the camera to note, metres.
    """
    options = footage.options
    images = (frame.image for frame in footage.frames_keeping_depth(folder, 1 / UNITS_PER_METRE))
    write_video(
        folder / f"{immersive_name(footage.shot.camera.name)}.mp4", images, options.fps, options.crf
    )
    return in_metres(footage.noted_camera())


def finish_immersive(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``models.json``, and ``depth_range.toml``, since that has no depth."""
    models = []
    for camera, shot in zip(cameras, fisheye_shots(options), strict=True):
        k1, k2, *_ = shot.lens
        models.append(
            {
                "name": immersive_name(camera.name),
                "position": camera.centre.tolist(),
                "orientation": rotation_vector(camera.rotation).tolist(),
                "focal_length": float(camera.K[0, 0]),
                "pixel_aspect_ratio": float(camera.K[1, 1] / camera.K[0, 0]),
                "principal_point": [float(camera.K[0, 2]), float(camera.K[1, 2])],
                "height": float(camera.height),
                "width": float(camera.width),
                "radial_distortion": [k1, k2, 0.0],
                "projection_type": "fisheye",
            }
        )
    write_depth_range(
        folder, min(camera.near for camera in cameras), max(camera.far for camera in cameras)
    )
    (folder / MODELS).write_text(json.dumps(models, indent=1) + "\n", encoding="utf-8")


def immersive_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [
        DEPTH_RANGE_FILE,
        MODELS,
        *(f"{immersive_name(name)}.mp4" for name in options.camera_names),
    ]


def immersive_name(name: str) -> str:
    """Return the name of a camera of the rig in the data set: ``camera_0001`` for cam00."""
    return f"camera_{int(name.removeprefix('cam')) + 1:04d}"
