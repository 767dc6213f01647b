"""Google Immersive's layout: fisheye videos ``camera_XXXX.mp4``, counted from 1, and ``models.json``; world units are metres."""

import json
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.rig import UNITS_PER_METRE, in_metres
from ggvs_eval.contrib.worlds.film.shots import fisheye_shots
from ggvs_eval.datasets.depth_range import DEPTH_RANGE_FILE, write_depth_range
from ggvs_eval.datasets.google_light_fields import MODELS
from ggvs_eval.files.video import write_video
from ggvs_eval.kernels.portable import rotation_vector


def write_film(folder: Path, footage: Footage) -> Camera:
    """Write the fisheye video of one camera and its exact depth, which is undistorted; gives the camera to note, metres."""
    options = footage.options
    images = (frame.image for frame in footage.frames_keeping_depth(folder, 1 / UNITS_PER_METRE))
    write_video(folder / f"{immersive_name(footage.shot.camera.name)}.mp4", images, options.fps, options.crf)
    return in_metres(footage.noted_camera())


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
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
    write_depth_range(folder, min(camera.near for camera in cameras), max(camera.far for camera in cameras))
    (folder / MODELS).write_text(json.dumps(models, indent=1) + "\n", encoding="utf-8")


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [DEPTH_RANGE_FILE, MODELS, *(f"{immersive_name(name)}.mp4" for name in options.camera_names)]


def immersive_name(name: str) -> str:
    """Name of a camera of the rig in the data set: ``camera_0001`` for cam00."""
    return f"camera_{int(name.removeprefix('cam')) + 1:04d}"
