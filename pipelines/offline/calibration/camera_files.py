"""Frames of a rig, handed to COLMAP and put beside its model."""

import shutil
from collections.abc import Mapping
from pathlib import Path

from ggvs_eval.datasets.camera_frames import CameraFrames
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import VideoFrames


def write_instant(files: Mapping[str, CameraFrames], frame: int, folder: Path) -> dict[str, str]:
    """Write one image per camera.

    Args:
        frame: the instant, from 0.
        folder: where to; made.

    Returns:
        Camera -> name of its image: the camera's name, with the suffix of its file where that is a single upright image, which is
        copied. Others are written as they are read: COLMAP does not heed the EXIF tag that turns them.
    """
    images = {}
    folder.mkdir(parents=True)
    for name, file in files.items():
        if frame >= file.n_frames:
            raise CaptureError(f"{file.path}: wanted frame {frame}, it has {file.n_frames}; choose an earlier frame")
        image = next(file.frames(frame, frame + 1))
        is_copied = isinstance(file, ImageFrames) and file.path.is_file() and not file.orientations
        images[name] = f"{name}{file.path.suffix if is_copied else '.png'}"
        if images[name].lower().endswith(".png"):
            write_image(folder / images[name], image)
        else:
            shutil.copyfile(file.path, folder / images[name])
    return images


def link_frames(files: Mapping[str, CameraFrames], stills: Mapping[str, Path], folder: Path) -> None:
    """Put frames where the COLMAP adapter looks for them: links to videos and folders, single images themselves.

    Args:
        stills: the image of each camera, which is moved where it is all there is of that camera.
    """
    for name, file in files.items():
        if isinstance(file, VideoFrames):
            (folder / f"{name}.mp4").symlink_to(file.path.resolve())
            continue
        (folder / "images").mkdir(exist_ok=True)
        if file.path.is_dir():
            (folder / "images" / name).symlink_to(file.path.resolve())
        else:
            shutil.move(stills[name], folder / "images" / stills[name].name)
