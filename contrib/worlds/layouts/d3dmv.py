"""Deep 3D Mask Volume's layout: one HDF5 file with all frames, and LLFF poses."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.lib.format import open_memmap

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import PARTS, Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.files.images import quantise
from ggvs_eval.synthetic.d3dmv_scene import SCENE, write_scene

POSES = "scene000_pb.npy"
# The poses are those of the images before they were compressed, 1280 x 720 for 640 x 360.
POSE_SCALE = 2


def write_shot(folder: Path, footage: Footage) -> Camera:
    """Write the frames of one camera to files of their own and its exact depth; gives the camera to note."""
    camera, options = footage.noted_camera(), footage.options
    size = (options.n_frames, options.height, options.width)
    rgb = open_memmap(_part(folder, camera, "rgb"), "w+", np.uint8, (*size, 3))
    alpha = open_memmap(_part(folder, camera, "alpha"), "w+", np.uint8, size)
    for index, frame in enumerate(footage.frames_keeping_depth(folder)):
        rgb[index], alpha[index] = frame.image, quantise(frame.foreground)
    return camera


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Join the frames of all cameras in ``scene000.h5`` and write ``scene000_pb.npy``."""
    rgb, alpha = ([np.load(_part(folder, camera, key), mmap_mode="r") for camera in cameras] for key in ("rgb", "alpha"))
    write_scene(folder / SCENE, rgb, alpha)
    large = [camera.resized(POSE_SCALE * camera.width, POSE_SCALE * camera.height) for camera in cameras]
    write_llff_poses(folder / POSES, [llff_pose(camera) for camera in large])


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [SCENE, POSES]


def _part(folder: Path, camera: Camera, key: str) -> Path:
    return folder / PARTS / f"{camera.name}_{key}.npy"
