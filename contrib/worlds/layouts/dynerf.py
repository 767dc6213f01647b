"""DyNeRF's layout: a video per camera and ``poses_bounds.npy``; a true camera path beside them."""

from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video

POSES = "poses_bounds.npy"


def write_film(folder: Path, footage: Footage) -> Camera:
    """Write ``camXX.mp4`` with its exact depth, or one image of the path; gives the camera to note."""
    camera = footage.noted_camera()
    if footage.shot.sensor is None:
        write_image(folder / "path" / "images" / f"{camera.name}.png", next(footage.frames()).image)
    else:
        images = (frame.image for frame in footage.frames_keeping_depth(folder))
        write_video(folder / f"{camera.name}.mp4", images, footage.options.fps, footage.options.crf)
    return camera


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``poses_bounds.npy`` of the rig and of the path."""
    on_rig, on_path = split_path(options, cameras)
    write_llff_poses(folder / POSES, [llff_pose(camera) for camera in on_rig])
    write_path_poses(folder, on_path)


def split_path(options: DemoOptions, cameras: Sequence[Camera]) -> tuple[Sequence[Camera], Sequence[Camera]]:
    """The cameras of the rig and those of the path."""
    count = len(options.camera_names)
    return cameras[:count], cameras[count:]


def write_path_poses(folder: Path, cameras: Sequence[Camera]) -> None:
    """Write ``path/poses_bounds.npy``, if there is a path."""
    if cameras:
        write_llff_poses(folder / "path" / POSES, [llff_pose(camera) for camera in cameras])


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [POSES, *(f"{name}.mp4" for name in options.camera_names)]
