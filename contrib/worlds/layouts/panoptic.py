"""Panoptic Sports' layout: a folder of JPEG images per camera, and the calibration of each instant in two JSON files."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.rig import UNITS_PER_METRE, in_metres
from ggvs_eval.contrib.worlds.layouts.encoded_images import write_jpeg
from ggvs_eval.datasets.depth_range import DEPTH_RANGE_FILE, write_depth_range
from ggvs_eval.datasets.panoptic import IMAGES, METAS

EVERY = 4  # camera of so many is held out


def write_shot(folder: Path, footage: Footage) -> Camera:
    """Write the images of one camera and its exact depth; gives the camera to note, metres."""
    camera = in_metres(footage.noted_camera())
    for index, frame in enumerate(footage.frames_keeping_depth(folder, 1 / UNITS_PER_METRE)):
        write_jpeg(folder / IMAGES / _image(camera.name, index), frame.image)
    return camera


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write both files, and ``depth_range.toml``, since they have no depth."""
    for file, is_test in zip(METAS, (False, True), strict=True):
        chosen = [camera for index, camera in enumerate(cameras) if (index % EVERY == 1) == is_test]
        (folder / file).write_text(json.dumps(_meta(chosen, options.n_frames)), encoding="utf-8")
    write_depth_range(folder, min(camera.near for camera in cameras), max(camera.far for camera in cameras))


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    images = [f"{IMAGES}/{_image(name, index)}" for name in options.camera_names for index in range(options.n_frames)]
    return [DEPTH_RANGE_FILE, *METAS, *images]


def _meta(cameras: Sequence[Camera], n_frames: int) -> dict[str, Any]:
    return {
        "w": cameras[0].width if cameras else 0,
        "h": cameras[0].height if cameras else 0,
        "k": [[camera.K.tolist() for camera in cameras]] * n_frames,
        "w2c": [[camera.world_to_camera.tolist() for camera in cameras]] * n_frames,
        "fn": [[_image(camera.name, index) for camera in cameras] for index in range(n_frames)],
        "cam_id": [[_number(camera.name) for camera in cameras]] * n_frames,
    }


def _image(name: str, index: int) -> str:
    return f"{_number(name)}/{index:06d}.jpg"


def _number(name: str) -> int:
    return int(name.removeprefix("cam"))
