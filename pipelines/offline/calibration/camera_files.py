"""The frames of each camera in a folder that has no calibration yet: videos, folders of images, or one image per camera."""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.files.listing import list_images
from ggvs_eval.files.video import VideoFrames

CameraFiles = VideoFrames | ImageFrames
VIDEO_SUFFIXES = (".mp4", ".mov")
ARRANGEMENTS = "CAM.mp4, videos/CAM.mp4, images/CAM/, frames/CAM/, CAM/images/, CAM/, or one image per camera here or in images/"
# Folders that captures hold beside those of their cameras.
NO_CAMERAS = {"images", "frames", "videos", "background", "bkgd", "mask", "masks", "bgmtv2", "schp", "depth", "path", "sparse"}


def find_camera_files(folder: Path) -> dict[str, CameraFiles]:
    """The frames of each camera by the first arrangement that holds two cameras or more, in the order of names.

    Raises:
        CaptureError: no such folder, no two cameras in it, or two videos of one name.
    """
    if not folder.is_dir():
        there = "a file" if folder.exists() else "nothing there"
        raise CaptureError(f"{folder}: wanted a folder with the frames of several cameras, got {there}; check the path")
    for arrangement in _arrangements(folder):
        names = [name for name, _ in arrangement]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            listed = ", ".join(twice)
            raise CaptureError(f"{folder}: wanted one file per camera, got several called {listed}; remove or rename the others")
        if len(names) > 1:
            return dict(sorted(arrangement))
    raise CaptureError(
        f"{folder}: wanted the frames of two cameras or more, got none; put them in {ARRANGEMENTS} "
        "(a capture that keeps them otherwise: 'ggvs-eval undistort' writes its frames as videos)"
    )


def check_lengths(folder: Path, files: Mapping[str, CameraFiles]) -> None:
    """Refuse cameras with different numbers of frames: no capture may have them, and that is better said before any work.

    Raises:
        CaptureError: they differ, or a video is damaged.
    """
    counts = {name: file.n_frames for name, file in files.items()}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise CaptureError(f"{folder}: wanted one number of frames for all cameras, got {listed}; cut them to a common length")


def write_instant(files: Mapping[str, CameraFiles], frame: int, folder: Path) -> dict[str, str]:
    """Write one image per camera.

    Args:
        files: frames of each camera.
        frame: the instant, from 0.
        folder: where to; made.

    Returns:
        Camera -> name of its image: the camera's name, with the suffix of its file where that is a single image.

    Raises:
        CaptureError: the instant is not there, or does not decode.
    """
    images = {}
    folder.mkdir(parents=True)
    for name, file in files.items():
        if frame >= file.n_frames:
            raise CaptureError(f"{file.path}: wanted frame {frame}, it has {file.n_frames}; choose an earlier frame")
        image = next(file.frames(frame, frame + 1))
        is_still = isinstance(file, ImageFrames) and file.path.is_file()
        images[name] = f"{name}{file.path.suffix if is_still else '.png'}"
        if images[name].endswith(".png"):
            write_image(folder / images[name], image)
        else:
            shutil.copyfile(file.path, folder / images[name])
    return images


def link_frames(files: Mapping[str, CameraFiles], stills: Mapping[str, Path], folder: Path) -> None:
    """Put frames where the COLMAP adapter looks for them: links to videos and folders, single images themselves.

    Args:
        files: frames of each camera.
        stills: the image of each camera, which is moved where it is all there is of that camera.
        folder: the capture.
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


def _arrangements(folder: Path) -> Iterator[list[tuple[str, CameraFiles]]]:
    for parent in (folder, folder / "videos"):
        yield [(file.stem, VideoFrames(file)) for file in _entries(parent) if file.suffix.lower() in VIDEO_SUFFIXES]
    for parent in (folder / "images", folder / "frames"):
        yield [(each.name, ImageFrames(each)) for each in _entries(parent) if list_images(each)]
    cameras = [each for each in _entries(folder) if each.is_dir() and each.name not in NO_CAMERAS]
    yield [(each.name, ImageFrames(each / "images")) for each in cameras if list_images(each / "images")]
    yield [(each.name, ImageFrames(each)) for each in cameras if list_images(each)]
    for parent in (folder / "images", folder):
        yield [(file.stem, ImageFrames(file)) for file in list_images(parent)]


def _entries(folder: Path) -> list[Path]:
    """List the entries of a folder, hidden ones aside."""
    return sorted(entry for entry in folder.iterdir() if not entry.name.startswith(".")) if folder.is_dir() else []
