"""DyNeRF / Neural 3D Video captures: ``camXX.mp4`` with ``poses_bounds.npy``, and the frame folders other code makes of them."""

import re
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import SizedSource, assemble_capture, check_rig_size
from ggvs_eval.datasets.camera_frames import frames_in
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.llff import llff_camera, read_llff_poses
from ggvs_eval.datasets.units import GivenUnits, choose_units, read_note
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import unread_videos

POSES = "poses_bounds.npy"
FRAME_FOLDERS = ("frames", "frames_2", "frames_4", "frames_8")
PLACES = ("CAM.mp4", "CAM/images/", *(f"{folder}/CAM/" for folder in FRAME_FOLDERS), "images/CAM/")
STILLS = ("images/CAM.png", "images_4/CAM.png", "images_8/CAM.png")  # one picture per camera, as LLFF has them
ARRANGEMENTS = "camXX.mp4, camXX/images/, frames/camXX/, frames_N/camXX/, images/XX/ or, of stills, images/NAME.jpg"


def refuse(path: Path) -> str | None:
    """Return the reason why this folder is not a DyNeRF capture, or None if it is one."""
    if not (path / POSES).is_file():
        return f"no {POSES}"
    if _find_sources(path):
        return None
    unread = unread_videos(path)
    return f"{POSES}, but no frames ({unread or ARRANGEMENTS})"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a DyNeRF capture with any number of cameras.

    Reading:
        Row i belongs to the i-th camera in the order of names, never to the number in a name (numbers may be missing). One focal
        length, principal point in the image centre, both scaled from the size in the file to the size of the frames. Pictures in
        ``images/`` alone are LLFF's: one instant, one camera each.
    """
    sources = _find_sources(path)
    check_rig_size(path, len(sources))
    poses = read_llff_poses(path / POSES)
    if len(poses) != len(sources):
        raise CaptureError(
            f"{path / POSES}: wanted one row for each of the {len(sources)} cameras on disk ({_describe(list(sources))}), "
            f"got {len(poses)} rows; restore the missing {'videos' if len(poses) > len(sources) else 'rows'}"
        )
    cameras = [llff_camera(pose, name, path / POSES) for pose, name in zip(poses, sources, strict=True)]
    return assemble_capture(path, "dynerf", cameras, list(sources.values()), choose_units(path, units, cameras))


def _find_sources(path: Path) -> dict[str, SizedSource]:
    """The frames of each camera in the order of names, by the first arrangement that is there."""
    for place in PLACES:
        name = r"\d+" if place.startswith("images/") else r"cam\d+"
        sources = dict(sorted(found for found in frames_in(path, place, even_empty=True) if re.fullmatch(name, found[0])))
        if sources:
            _check_name_lengths(path, list(sources))
            return dict(sources)
    return next((dict(sorted(stills)) for stills in (frames_in(path, place) for place in STILLS) if stills), {})


def _check_name_lengths(path: Path, names: list[str]) -> None:
    if len({len(name) for name in names}) > 1:
        mismatch = f"{min(names, key=len)} and {max(names, key=len)}"
        raise CaptureError(
            f"{path}: wanted camera numbers of one length, got {mismatch}; add leading zeros, in the order of {POSES}"
        )


def _describe(names: list[str]) -> str:
    """The names in a few words: first, last, and the numbers missing between them."""
    if not all(name.removeprefix("cam").isdecimal() for name in names):
        return f"{names[0]}..{names[-1]}"
    numbers = {int(name.removeprefix("cam")) for name in names}
    missing = sorted(set(range(min(numbers), max(numbers))) - numbers)
    listed = f" without {', '.join(map(str, missing))}" if missing else ""
    return f"{names[0]}..{names[-1]}{listed}"


@dataclass(frozen=True)
class CameraPath:
    """Poses along a path and what a camera would have seen there.

    Attributes:
        cameras: one pose per image, called ``path0000``, ...
        images: the true images; None where only the poses are known.
        time_s: the instant of the capture that they show, as ``demo.json`` says; the first where it says nothing.
    """

    cameras: tuple[Camera, ...]
    images: ImageFrames | None
    time_s: float


def open_path(capture_folder: Path) -> CameraPath | None:
    """Open ``path/poses_bounds.npy`` and ``path/images/`` of a capture folder; None where it carries no path."""
    poses_file = capture_folder / "path" / POSES
    if not poses_file.is_file():
        return None
    poses = read_llff_poses(poses_file)
    cameras = tuple(llff_camera(pose, f"path{index:04d}", poses_file) for index, pose in enumerate(poses))
    time_s = read_note(capture_folder, "path_time_s") or 0.0
    folder = capture_folder / "path" / "images"
    if not folder.is_dir():
        return CameraPath(cameras, None, time_s)
    images = ImageFrames(folder)
    if images.n_frames != len(cameras):
        raise CaptureError(f"{folder}: wanted {len(cameras)} images, one per row of {poses_file.name}, got {images.n_frames}")
    return CameraPath(tuple(camera.resized(*images.size) for camera in cameras), images, time_s)


LAYOUT = DatasetSpec(f"poses_bounds.npy with {ARRANGEMENTS}", refuse, load, (POSES,))
