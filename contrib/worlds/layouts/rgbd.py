"""The layout that ScanNet's exporter writes: colour, sensor depth and pose of every frame of a hand-held camera; metres."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.depth import measured, misplaced
from ggvs_eval.contrib.worlds.film.film import Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import render_depth
from ggvs_eval.contrib.worlds.film.rig import UNITS_PER_METRE, in_metres
from ggvs_eval.contrib.worlds.layouts.encoded_images import write_grey_png, write_jpeg

MILLIMETRES_PER_UNIT = 1000 / UNITS_PER_METRE
LARGEST_MM = np.iinfo(np.uint16).max
# The exporter writes six decimals; these hold a pose to 1e-6 after its inversion too.
DECIMALS = "%.10f"


def write_shot(folder: Path, footage: Footage) -> Camera:
    """Write colour, depth and pose of one frame; gives the camera to note, metres.

    Reading:
        The depth camera has half the colour camera's resolution, its place and its view; its pixels are looked at by themselves.
    """
    camera, options = in_metres(footage.noted_camera()), footage.options
    write_jpeg(folder / "color" / f"{camera.name}.jpg", next(footage.frames()).image)
    sensor = misplaced(options, depth_camera(footage.shot.depth_pose or footage.shot.camera), options.width)
    depth = measured(options, render_depth(footage.instant(0), sensor), int(camera.name))
    millimetres = np.minimum(np.rint(depth.astype(np.float64) * MILLIMETRES_PER_UNIT), LARGEST_MM).astype(np.uint16)
    write_grey_png(folder / "depth" / f"{camera.name}.png", millimetres)
    _write_matrix(folder / "pose" / f"{camera.name}.txt", _camera_to_world(camera))
    return camera


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``intrinsic/``."""
    colour = cameras[0]
    for kind, camera in (("color", colour), ("depth", depth_camera(colour))):
        K = np.eye(4)
        K[:3, :3] = camera.K
        _write_matrix(folder / "intrinsic" / f"intrinsic_{kind}.txt", K)
        _write_matrix(folder / "intrinsic" / f"extrinsic_{kind}.txt", np.eye(4))


def depth_camera(colour: Camera) -> Camera:
    """The sensor of depth, of half the resolution."""
    return colour.resized(colour.width // 2, colour.height // 2)


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    kinds = (("color", "jpg"), ("depth", "png"), ("pose", "txt"))
    frames = [f"{folder}/{index}.{kind}" for folder, kind in kinds for index in range(options.n_frames)]
    return [*(f"intrinsic/{what}_{kind}.txt" for what in ("intrinsic", "extrinsic") for kind in ("color", "depth")), *frames]


def _camera_to_world(camera: Camera) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = camera.rotation.T, camera.centre
    return pose


def _write_matrix(path: Path, matrix: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, matrix, fmt=DECIMALS)
