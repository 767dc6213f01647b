"""A calibration file of another tool beside the frames that it is of: such a folder is a capture as it stands."""

import re
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import ARRANGEMENTS, assemble_capture, check_rig_size, first_sources, listed
from ggvs_eval.datasets.camera_readers import (
    LARGEST_XML_BYTES,
    FileCamera,
    read_anipose,
    read_opencv,
    read_qualisys,
)
from ggvs_eval.datasets.colmap_model import undistorted_sources
from ggvs_eval.datasets.depth_range import rig_depth_range
from ggvs_eval.datasets.units import GivenUnits, Units, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.plain import read_plain_text

DESCRIBE = "a calibration of Qualisys (*.qca.txt), anipose or freemocap (TOML) or OpenCV (YAML) beside videos"
QUALISYS_SUFFIX = ".qca.txt"
# What tells such files from others of their kind, before they are parsed.
ANIPOSE = re.compile(r"^[ \t]*matrix[ \t]*=", re.MULTILINE)
OPENCV = re.compile(r"^(camera_matrix|M1|K1|cameraMatrix1)[ \t]*:", re.MULTILINE)
MILLIMETRES = "the calibration is in millimetres"


@dataclass(frozen=True, eq=False)
class CameraFile:
    """What calibration files say.

    Attributes:
        cameras: by name.
        units: 1 per metre where the unit is known; None where it is not.
    """

    cameras: dict[str, FileCamera]
    units: Units | None


def refuse(path: Path) -> str | None:
    """Why there is no such calibration; None where there is one."""
    return None if find_camera_files(path) else "no *.qca.txt, no TOML of anipose, no YAML of OpenCV with a camera_matrix"


def find_camera_files(path: Path) -> list[Path]:
    """The calibration files in a folder, of the first kind that is there; the file itself where it is one.

    A file for each camera is usual with OpenCV, so there may be several.
    """
    files = sorted(each for each in path.iterdir() if not each.name.startswith(".")) if path.is_dir() else [path]
    for is_kind in (_is_qualisys, _is_anipose, _is_opencv):
        found = [file for file in files if is_kind(file)]
        if found:
            return found
    return []


def read_camera_file(path: Path) -> CameraFile:
    """Read a calibration file, or all those of a folder that `find_camera_files` gives.

    Raises:
        CaptureError: none there, a damaged one, or two cameras of one name.
    """
    cameras: list[FileCamera] = []
    units: Units | None = None
    for file in find_camera_files(path):
        is_metric = _is_qualisys(file)
        if is_metric:
            cameras += read_qualisys(file)
        elif _is_anipose(file):
            more, is_metric = read_anipose(file)
            cameras += more
        else:
            cameras += read_opencv(file)
        units = Units(1.0, MILLIMETRES) if is_metric else units
    check_rig_size(path, len(cameras))
    names = [camera.name for camera in cameras]
    if not names or not all(names) or len(set(names)) < len(names):
        raise CaptureError(f"{path}: wanted a calibration with cameras of different names, got {listed(names) or 'none'}; mend it")
    return CameraFile(dict(zip(names, cameras, strict=True)), units)


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a folder of videos or images with its calibration file; frames are undistorted as they are read.

    Args:
        path: the folder, or the calibration file in it.
        units: world units per metre or a file that says how to measure them; see `choose_units`.

    Raises:
        CaptureError: a damaged file, fewer than two of its cameras with frames, or a camera without pose.

    Reading:
        Cameras without frames are left out and noted: a motion-capture studio has cameras that see markers alone. Depth ranges
        are those of `rig_depth_range`; ``ggvs-eval calibrate --known-poses`` measures them.
    """
    folder = path if path.is_dir() else path.parent
    file = read_camera_file(path)
    found = first_sources(folder, {name: f"{name}.png" for name in file.cameras})
    if len(found) < 2:
        raise CaptureError(
            f"{folder}: wanted frames of two or more of {listed(list(file.cameras))}, got {listed(list(found)) or 'none'}; call "
            f"videos and cameras alike and put them in {ARRANGEMENTS}"
        )
    chosen = [camera for camera in file.cameras.values() if camera.name in found]
    without = [camera.name for camera in chosen if camera.world_to_camera is None]
    if without:
        mend = f"'ggvs-eval calibrate {folder} RIG --known-intrinsics {path}' finds them"
        raise CaptureError(f"{path}: wanted poses, got intrinsics alone of {listed(without)}; {mend}")
    poses = [camera.world_to_camera for camera in chosen if camera.world_to_camera is not None]
    try:
        lenses = [camera.lens(found[camera.name].size) for camera in chosen]
        cameras = [
            Camera(camera.name, lens.undistorted_K(), pose, lens.width, lens.height, *depths)
            for camera, lens, pose, depths in zip(chosen, lenses, poses, rig_depth_range(poses), strict=True)
        ]
    except CameraError as error:
        raise CaptureError(f"{path}: {error}") from error
    sources = undistorted_sources([found[camera.name] for camera in chosen], lenses, cameras)
    left = [name for name in file.cameras if name not in found]
    notes = [f"{listed(left)} left out: calibrated, but without frames"] if left else []
    return assemble_capture(
        folder, "camera-file", cameras, sources, choose_units(folder, units, cameras, known=file.units), notes=notes
    )


def _is_qualisys(file: Path) -> bool:
    return file.name.lower().endswith(QUALISYS_SUFFIX)


def _is_anipose(file: Path) -> bool:
    return file.suffix == ".toml" and bool(ANIPOSE.search(_text(file)))


def _is_opencv(file: Path) -> bool:
    return file.suffix in (".yml", ".yaml") and bool(OPENCV.search(_text(file)))


def _text(file: Path) -> str:
    """The text of a file; none where it cannot be read."""
    try:
        return read_plain_text(file, LARGEST_XML_BYTES)
    except (OSError, UnicodeDecodeError):
        return ""
