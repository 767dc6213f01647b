"""Captures that are a calibration file of another tool next to its frames, read without conversion."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import CROP_FILE, assemble_capture, check_rig_size, given_crop
from ggvs_eval.datasets.calibration_readers import (
    LARGEST_XML_BYTES,
    FileCamera,
    read_anipose,
    read_opencv,
    read_qualisys,
)
from ggvs_eval.datasets.camera_frames import find_frames, instead_of_frames, listed
from ggvs_eval.datasets.colmap_model import undistorted_sources
from ggvs_eval.datasets.depth_range import Placed, ranged_cameras
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.units import GivenUnits, Units, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.listing import list_entries
from ggvs_eval.files.plain import read_plain_text

# Marks of such files among others of their suffix, before they are parsed.
ANIPOSE = re.compile(r"^[ \t]*matrix[ \t]*=", re.MULTILINE)
MATRIX = "(camera_matrix|Camera_Matrix|M1|K1|cameraMatrix1?)"
OPENCV = re.compile(rf"^{MATRIX}[ \t]*:|<{MATRIX}[ >]", re.MULTILINE)
MILLIMETRES = Units(1.0, "converted from the millimetres of the calibration")


@dataclass(frozen=True)
class Kind:
    """One kind of calibration file.

    Attributes:
        describe: its layout in one line.
        content: what their text holds; None if the suffix says enough.
        read: gives the cameras of a file.
    """

    describe: str
    suffixes: tuple[str, ...]
    content: re.Pattern[str] | None
    read: Callable[[Path], list[FileCamera]]

    def fits(self, file: Path) -> bool:
        """Return whether a file is of this kind."""
        if not file.name.lower().endswith(self.suffixes):
            return False
        return self.content is None or bool(self.content.search(_text(file)))


KINDS = {
    "qualisys": Kind("CALIBRATION.qca.txt (Qualisys) next to videos", (".qca.txt",), None, read_qualisys),
    "anipose": Kind(
        "CALIBRATION.toml (anipose, freemocap, pose2sim, caliscope) next to videos", (".toml",), ANIPOSE, read_anipose
    ),
    "opencv": Kind("CAM.yml or STEREO.xml (cv2.FileStorage, ROS) next to videos", (".yml", ".yaml", ".xml"), OPENCV, read_opencv),
}


@dataclass(frozen=True, eq=False)
class CalibrationFile:
    """Cameras of calibration files.

    Attributes:
        units: 1 per metre where the unit is known; None if it is not.
    """

    cameras: dict[str, FileCamera]
    units: Units | None


def refuse(kind: str, path: Path) -> str | None:
    """State why there is no calibration of a kind; None if there is one."""
    kinds = " or ".join(f"*{suffix}" for suffix in KINDS[kind].suffixes)
    return None if find_calibration_files(path, kind) else f"no calibration of this kind in {kinds}"


def find_calibration_files(path: Path, kind: str | None = None) -> list[Path]:
    """Return the calibration files in a folder, of one kind or of the first that is there; the file itself where it is one.

    A file for each camera is usual with OpenCV, so there may be several.
    """
    return _find(path, kind)[1]


def read_calibration_file(path: Path, kind: str | None = None) -> CalibrationFile:
    """Read a calibration file, or all those of a folder that `find_calibration_files` gives."""
    read, files = _find(path, kind)
    cameras = [camera for file in files for camera in read(file)]
    check_rig_size(path, len(cameras))
    if len({camera.name for camera in cameras}) < len(cameras) == len({camera.stem for camera in cameras if camera.stem}):
        cameras = [replace(camera, name=camera.stem) for camera in cameras]  # ROS writes one name into every file
    names = [camera.name for camera in cameras]
    if not names:
        there = listed([file.name for file in files]) or "no file"
        raise CaptureError(f"{path}: wanted cameras, got {there}, of an unknown form; see docs/your_rig.md for the known forms")
    if not all(names) or len(set(names)) < len(names):
        raise CaptureError(
            f"{path}: wanted a calibration with cameras of different names, got {listed(names)}; correct the names"
        )
    is_metric = all(camera.is_metric for camera in cameras)
    return CalibrationFile(dict(zip(names, cameras, strict=True)), MILLIMETRES if is_metric else None)


def load(kind: str, path: Path, units: GivenUnits) -> Capture:
    """Open a folder of videos or images with its calibration file; frames are undistorted as they are read.

    Raises:
        CaptureError: a damaged file, fewer than two of its cameras with frames, or a camera without pose.

    Reading:
        Cameras without a pose or frames are left out and noted: a motion-capture studio has cameras that see markers alone.
    """
    folder = path if path.is_dir() else path.parent
    file = read_calibration_file(path, kind)
    frames = find_frames(folder, {name: f"{name}.png" for name in file.cameras}).sources
    stems = {camera.stem: replace(camera, name=camera.stem) for camera in file.cameras.values() if camera.stem}
    if (
        not frames
        and len(stems) == len(file.cameras)
        and (by_stem := find_frames(folder, {name: f"{name}.png" for name in stems}).sources)
    ):
        file, frames = replace(file, cameras=stems), by_stem
    if len(frames) < 2:
        missing = [name for name in file.cameras if name not in frames]
        content = f"those of {listed(frames)} alone" if frames else instead_of_frames(folder, missing)
        raise CaptureError(
            f"{folder}: wanted frames of two or more of {listed(file.cameras)}, got {content}; rename videos like their cameras"
        )
    filmed = [camera for camera in file.cameras.values() if camera.name in frames]
    chosen = [camera for camera in filmed if camera.world_to_camera is not None]
    if len(chosen) < 2:
        without = [camera.name for camera in filmed if camera.world_to_camera is None]
        remedy = f"'ggvs-eval calibrate {folder} RIG --known-intrinsics {path}' finds them"
        raise CaptureError(f"{path}: wanted poses, got only intrinsics of {listed(without)}; {remedy}")
    crop = given_crop(folder)
    poses = [camera.world_to_camera for camera in chosen if camera.world_to_camera is not None]
    try:
        lenses = [camera.lens(frames[camera.name].size, crop) for camera in chosen]
        rig = [
            Placed(camera.name, lens.undistorted_K(), pose, (lens.width, lens.height))
            for camera, lens, pose in zip(chosen, lenses, poses, strict=True)
        ]
    except CameraError as error:
        raise CaptureError(f"{path}: {error}") from error
    cameras = ranged_cameras(rig, path)
    sources = undistorted_sources([frames[camera.name] for camera in chosen], lenses, cameras)
    left = {
        "calibrated, but without frames": [name for name in file.cameras if name not in frames],
        "calibrated, but without a pose": [camera.name for camera in filmed if camera.world_to_camera is None],
    }
    notes = [f"{listed(names)} left out: {why}" for why, names in left.items() if names]
    cut = [
        camera.name for camera, lens in zip(chosen, lenses, strict=True) if camera.size not in (None, (lens.width, lens.height))
    ]
    unknown = sorted({key for camera in chosen for key in camera.unknown})
    notes += [f"{path.name}: {listed(unknown)} unknown here, ignored"] if unknown else []
    if cut and crop:
        notes.append(f"frames of {listed(cut)} begin at {crop.left} {crop.top} of the calibrated picture, by {CROP_FILE}")
    return assemble_capture(
        folder, kind, cameras, sources, choose_units(folder, units, cameras, of_data_set=file.units), notes=notes
    )


def _find(path: Path, kind: str | None) -> tuple[Callable[[Path], list[FileCamera]], list[Path]]:
    """Return the files of `find_calibration_files`, and what reads them."""
    files = list_entries(path) if path.is_dir() else [path]
    for each in KINDS.values() if kind is None else [KINDS[kind]]:
        if fitting := [file for file in files if each.fits(file)]:
            return each.read, fitting
    return lambda _: [], []


def _text(file: Path) -> str:
    """Return the text of a file; none if it cannot be read."""
    try:
        return read_plain_text(file, LARGEST_XML_BYTES)
    except (OSError, UnicodeDecodeError):
        return ""


QUALISYS_LAYOUT, ANIPOSE_LAYOUT, OPENCV_LAYOUT = (
    DatasetSpec(KINDS[name].describe, partial(refuse, name), partial(load, name)) for name in ("qualisys", "anipose", "opencv")
)
