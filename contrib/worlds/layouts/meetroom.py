"""MeetRoom's layout: a video per camera, numbered without leading zeros, and ``poses_bounds.npy`` in the order of the numbers."""

from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.files.video import write_video

POSES = "poses_bounds.npy"


def write_film(folder: Path, footage: Footage) -> Camera:
    """Write ``cam_<N>.mp4`` and its exact depth; gives the camera to note."""
    options = footage.options
    images = (frame.image for frame in footage.frames_keeping_depth(folder))
    write_video(folder / _video(footage.shot.camera.name), images, options.fps, options.crf)
    return footage.noted_camera()


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``poses_bounds.npy``."""
    write_llff_poses(folder / POSES, [llff_pose(camera) for camera in cameras])


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [POSES, *map(_video, options.camera_names)]


def _video(name: str) -> str:
    return f"cam_{int(name.removeprefix('cam'))}.mp4"
