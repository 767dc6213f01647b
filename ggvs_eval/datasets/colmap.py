"""Captures calibrated by COLMAP: a sparse model, and one image, image folder or video per camera."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import SizedSource, assemble_capture, choose_units
from ggvs_eval.datasets.frames import ImageFrames, list_images
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.video import VideoFrames

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0")
ARRANGEMENTS = "CAM.mp4, videos/CAM.mp4, images/CAM/, CAM/images/, CAM/ or one image per camera in images/"
# A little nearer and farther than all but the outermost hundredth of the points.
NEAR_FACTOR, FAR_FACTOR = 0.8, 1.2


def refuse(path: Path) -> str | None:
    """Why this folder is no COLMAP capture; None where it is one."""
    return None if _find_model(path) else f"no COLMAP model (cameras.bin or cameras.txt) in {', '.join(MODEL_FOLDERS)}"


def load(path: Path, units_per_metre: float | None) -> Capture:
    """Open a capture by its COLMAP model; cameras are called as their images in the model, without suffix, in the order of names.

    Args:
        path: folder that holds the model and the frames.
        units_per_metre: world units per metre; guessed from the median depth of the sparse points when None.

    Raises:
        CaptureError: the model is damaged or distorted, or a camera of the model has no frames on disk.

    Reading:
        near = 0.8 times the 1st, far = 1.2 times the 99th percentile of the depth of the points each camera sees.
    """
    folder = _find_model(path) or path
    images = {_camera_name(image["name"]): image for image in _read_model(folder)}
    cameras = [_make_camera(folder, name, image) for name, image in images.items()]
    sources = _find_sources(path, images)
    units = choose_units(path, units_per_metre, cameras, [image["depth_percentiles"][1] for image in images.values()])
    return assemble_capture(path, "colmap", cameras, sources, units)


def _find_model(path: Path) -> Path | None:
    folders = (path / folder for folder in MODEL_FOLDERS)
    return next((folder for folder in folders if any((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))), None)


def _read_model(folder: Path) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", "ggvs_eval.datasets.colmap_reader", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or [f"the reader ended with {done.returncode}"])[-1]
        raise CaptureError(f"{folder}: damaged COLMAP model, pycolmap says '{reason}'; copy or export the model again")
    images = json.loads(done.stdout)
    names = [_camera_name(image["name"]) for image in images]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not images:
        found = f"several images of {', '.join(twice)}" if twice else "none"
        raise CaptureError(f"{folder}: wanted one registered image per fixed camera, got {found}; calibrate with one instant")
    return images


def _camera_name(image_name: str) -> str:
    """``cam00.png`` and ``cam00/0000.png`` are both of camera cam00."""
    name = PurePosixPath(image_name)
    return name.parent.name or name.stem


def _make_camera(folder: Path, name: str, image: dict[str, Any]) -> Camera:
    if image["model"] not in ("SIMPLE_PINHOLE", "PINHOLE"):
        mend = "undistort images and model by 'colmap image_undistorter' first"
        raise CaptureError(f"{folder}: wanted a PINHOLE or SIMPLE_PINHOLE camera, {name} is {image['model']}; {mend}")
    if not image["depth_percentiles"]:
        raise CaptureError(
            f"{folder}: {name} sees none of the model's points, so its depth range is unknown; triangulate or drop it"
        )
    params = image["params"]
    fx, fy, cx, cy = params if len(params) == 4 else (params[0], *params)
    nearest, _, farthest = image["depth_percentiles"]
    world_to_camera = np.vstack([image["world_to_camera"], [0.0, 0.0, 0.0, 1.0]])
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    try:
        return Camera(name, K, world_to_camera, image["width"], image["height"], NEAR_FACTOR * nearest, FAR_FACTOR * farthest)
    except CameraError as error:
        raise CaptureError(f"{folder}: {error}") from error


def _find_sources(path: Path, images: dict[str, dict[str, Any]]) -> list[SizedSource]:
    """Frames of each camera by the first arrangement that holds any of them; it must hold all."""
    for sources in _arrangements(path, images):
        missing = sorted(set(images) - set(sources))
        if sources and missing:
            kept = next(iter(sources.values())).path
            raise CaptureError(
                f"{path}: no frames for {', '.join(missing)} beside {kept}; restore them or take them off the model"
            )
        if sources:
            return [sources[name] for name in images]
    raise CaptureError(f"{path}: wanted frames of {', '.join(images)}, got none; put them in {ARRANGEMENTS}")


def _arrangements(path: Path, images: dict[str, dict[str, Any]]) -> Iterator[dict[str, SizedSource]]:
    for pattern in ("{}.mp4", "videos/{}.mp4"):
        yield {name: VideoFrames(path / pattern.format(name)) for name in images if (path / pattern.format(name)).is_file()}
    for pattern in ("images/{}", "{}/images", "{}"):
        yield {name: ImageFrames(path / pattern.format(name)) for name in images if list_images(path / pattern.format(name))}
    files = {name: path / "images" / image["name"] for name, image in images.items()}
    yield {name: ImageFrames(file) for name, file in files.items() if file.is_file()}
