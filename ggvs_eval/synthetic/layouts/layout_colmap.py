"""COLMAP's layout: ``sparse/0`` as text with true points, and a video per camera; a true camera path beside them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.datasets.colmap_writer import FILES, Sightings, write_model
from ggvs_eval.synthetic.film.film import PARTS, Footage
from ggvs_eval.synthetic.film.options import DemoOptions
from ggvs_eval.synthetic.film.surface_points import sightings, surface_points
from ggvs_eval.synthetic.layouts.layout_dynerf import split_path, write_film, write_path_poses

MODEL = "sparse/0"
LEAST_VIEWS = 2


def write_shot(folder: Path, footage: Footage) -> Camera:
    """Write ``camXX.mp4`` with its exact depth and its sightings, or one image of the path; gives the camera to note."""
    if footage.shot.sensor is not None:
        points, image = surface_points(footage.options), next(footage.frames()).image
        seen = sightings(points, footage.shot.camera, footage.instant(0), image)
        np.savez(_part(folder, footage.shot.camera), **seen._asdict())
    return write_film(folder, footage)


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``sparse/0/{cameras,images,points3D}.txt`` and the poses of the path.

    Reading:
        Sightings are those of the true cameras at the first frame; only the cameras are written down with an error. Points that
        a single camera sees are left out, as it could not triangulate them.
    """
    on_rig, on_path = split_path(options, cameras)
    points = surface_points(options)
    seen = [_read_part(folder, camera) for camera in on_rig]
    views = np.bincount(np.concatenate([sights.point for sights in seen]), minlength=len(points))
    kept = [sights.rows(views[sights.point] >= LEAST_VIEWS) for sights in seen]
    write_model(folder / MODEL, on_rig, kept, points)
    write_path_poses(folder, on_path)


def files(options: DemoOptions) -> list[str]:
    """What must be there."""
    return [*(f"{MODEL}/{name}" for name in FILES), *(f"{name}.mp4" for name in options.camera_names)]


def _part(folder: Path, camera: Camera) -> Path:
    return folder / PARTS / f"{camera.name}.npz"


def _read_part(folder: Path, camera: Camera) -> Sightings:
    with np.load(_part(folder, camera)) as stored:
        return Sightings(stored["point"], stored["uv"], stored["rgb"])
