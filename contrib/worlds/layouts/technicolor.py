"""Technicolor's layout: the pictures of all cameras in one folder, frames counted from 1, and ``cameras_parameters.txt``."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets.depth_range import DEPTH_RANGE_FILE, write_depth_range
from ggvs_eval.datasets.technicolor import CALIBRATED_SIZE, COLUMNS, PARAMETERS
from ggvs_eval.files.images import write_image

SCENE = "Room"


def write_shot(folder: Path, footage: Footage) -> Camera:
    """Write the pictures of one camera and its exact depth; gives the camera to note."""
    camera = footage.noted_camera()
    for index, frame in enumerate(footage.frames_keeping_depth(folder)):
        write_image(folder / _picture(index, camera.name), frame.image)
    return camera


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``cameras_parameters.txt``, and ``depth_range.toml``, since that has no depth.

    Reading:
        The file has no size: its numbers are those of pictures of 2048 x 1088, whatever the demo's shape; the aspect ratio ar
        takes what the shape of the pictures leaves between focal lengths along rows and columns.
    """
    from scipy.spatial.transform import Rotation

    lines = [f"# {COLUMNS}"]
    for camera in cameras:
        scale_x, scale_y = np.array(CALIBRATED_SIZE) / camera.size
        fx, fy = camera.K[0, 0] * scale_x, camera.K[1, 1] * scale_y
        qx, qy, qz, qw = Rotation.from_matrix(camera.rotation).as_quat()
        row = [fx, camera.K[0, 2] * scale_x, camera.K[1, 2] * scale_y, fy / fx, 0.0, qw, qx, qy, qz, *camera.translation]
        lines.append(" ".join(repr(float(value)) for value in row))
    write_depth_range(folder, min(camera.near for camera in cameras), max(camera.far for camera in cameras))
    (folder / PARAMETERS).write_text("\n".join(lines) + "\n", encoding="utf-8")


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [
        DEPTH_RANGE_FILE,
        PARAMETERS,
        *(_picture(index, name) for name in options.camera_names for index in range(options.n_frames)),
    ]


def _picture(index: int, name: str) -> str:
    return f"{SCENE}_undist_{index + 1:05d}_{name.removeprefix('cam')}.png"
