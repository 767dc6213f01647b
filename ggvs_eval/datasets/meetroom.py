"""MeetRoom captures (StreamRF, Li et al., NeurIPS 2022): ``cam_<N>.mp4`` with ``poses_bounds.npy``, or a folder per instant."""

import re
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import SizedSource, assemble_capture, check_rig_size
from ggvs_eval.datasets.camera_frames import CameraFrames, frames_in, listed
from ggvs_eval.datasets.frame_folders import instant_pictures, numbered_folders
from ggvs_eval.datasets.frames import NumberedFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.llff import llff_camera, read_llff_poses
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CaptureError

POSES = "poses_bounds.npy"
VIDEO = re.compile(r"cam_(\d{1,4})")
PICTURE = re.compile(r"cam(\d{1,4})")
INSTANT = re.compile(r"(\d{4})")
FRAMES = ("frames", ".")


def refuse(path: Path) -> str | None:
    """Return the reason why this folder is no MeetRoom capture, or None if it is one."""
    if _videos(path):
        return None if (path / POSES).is_file() else f"cam_<N>.mp4, but no {POSES}"
    return None if _instants(path) else f"neither cam_<N>.mp4 nor 0000/images/cam00.png with {POSES}"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a capture in StreamRF's arrangement; its cameras are called cam00, cam01, ... by their numbers.

    Args:
        path: folder with ``poses_bounds.npy`` and ``cam_<N>.mp4``; or what StreamRF extracts of these, a folder per instant with
            ``images/camNN.png`` and the same ``poses_bounds.npy``, in ``frames/`` or in the folder itself.

    Reading:
        Row i belongs to the i-th camera in the order of numbers: StreamRF writes cam_2 as cam02 before it sorts. One focal length
        and a central principal point, as LLFF has it; the poses of the first instant count, which StreamRF copies to the others.
    """
    sources: dict[int, SizedSource] = dict(_videos(path))
    poses_file = path / POSES
    if not sources:
        instants = _instants(path)
        sources, poses_file = dict(_pictures(path, instants)), next(iter(instants.values())) / POSES
    check_rig_size(path, len(sources))
    poses = read_llff_poses(poses_file)
    if len(poses) != len(sources):
        there = listed([f"cam_{number}" for number in sorted(sources)])
        raise CaptureError(
            f"{poses_file}: wanted one row for each of the {len(sources)} cameras on disk ({there}), got {len(poses)}; "
            f"restore the missing {'cameras' if len(poses) > len(sources) else 'rows'}"
        )
    numbers = sorted(sources)
    cameras = [llff_camera(pose, f"cam{number:02d}", poses_file) for pose, number in zip(poses, numbers, strict=True)]
    frames = [sources[number] for number in numbers]
    return assemble_capture(path, "meetroom", cameras, frames, choose_units(path, units, cameras))


def _videos(path: Path) -> dict[int, CameraFrames]:
    """Camera number -> its video."""
    videos = [(VIDEO.fullmatch(name), video) for name, video in frames_in(path, "CAM.mp4")]
    return {int(match[1]): video for match, video in videos if match}


def _instants(path: Path) -> dict[int, Path]:
    """Folders of the instants by their numbers, in the order of time."""
    for parent in (path / name for name in FRAMES):
        folders = numbered_folders(parent, INSTANT)
        if folders and (next(iter(folders.values())) / POSES).is_file():
            return folders
    return {}


def _pictures(path: Path, instants: dict[int, Path]) -> dict[int, NumberedFrames]:
    """Camera number -> its pictures."""
    matches = [(PICTURE.fullmatch(name), files) for name, files in instant_pictures(instants).items()]
    return {int(match[1]): NumberedFrames(path, tuple(files)) for match, files in matches if match}


LAYOUT = DatasetSpec("poses_bounds.npy with cam_N.mp4 or 0000/images/camNN.png", refuse, load)
