"""Captures that are a calibration file of another tool next to its frames, read without
conversion.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size, describe_crop
from ggvs_eval.datasets.calibration_readers import (
    FileCamera,
    read_anipose,
    read_opencv,
    read_qualisys,
)
from ggvs_eval.datasets.camera_frames import find_frames
from ggvs_eval.datasets.easymocap import read_lenses
from ggvs_eval.datasets.filestorage_yaml import LARGEST_FILE_BYTES
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.media import folders_beside
from ggvs_eval.datasets.rig import RigCamera, pinhole_rig
from ggvs_eval.datasets.units import GivenUnits, Units, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.listing import list_entries, list_files_below
from ggvs_eval.files.names import listed
from ggvs_eval.files.plain import read_plain_text

# Marks of such files among others of their suffix, before they are parsed.
ANIPOSE = re.compile(r'^[ \t]*matrix[ \t]*=|"matrix"(?s:.*)"distortions"', re.MULTILINE)
MATRIX = "(camera_matrix|Camera_Matrix|M1|K1|cameraMatrix1?)"
EASYMOCAP = re.compile(r"^K_\w+[ \t]*:", re.MULTILINE)
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
    "qualisys": Kind(
        describe="CALIBRATION.qca.txt (Qualisys) next to videos",
        suffixes=(".qca.txt",),
        content=None,
        read=read_qualisys,
    ),
    "anipose": Kind(
        describe="CALIBRATION.toml (anipose, freemocap, pose2sim, caliscope) next to videos",
        suffixes=(".toml", ".json"),
        content=ANIPOSE,
        read=read_anipose,
    ),
    "easymocap": Kind(
        describe="intri.yml (EasyMocap), lenses alone",
        suffixes=(".yml", ".yaml"),
        content=EASYMOCAP,
        read=lambda path: [*read_lenses(path).values()],
    ),
    "opencv": Kind(
        describe="CAM.yml or STEREO.xml (cv2.FileStorage, ROS) next to videos",
        suffixes=(".yml", ".yaml", ".xml"),
        content=OPENCV,
        read=read_opencv,
    ),
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
    """Return the calibration files in a folder, of one kind or of the first that is there.

    The file itself where it is one.

    A file for each camera is usual with OpenCV, so there may be several.
    """
    return _find(path, kind)[1]


def read_calibration_file(path: Path, kind: str | None = None) -> CalibrationFile:
    """Read a calibration file, or all those of a folder that `find_calibration_files` gives."""
    reader, files = _find(path, kind)
    cameras = [camera for file in files for camera in reader(file)]
    check_rig_size(path, len(cameras))
    if (
        len({camera.name for camera in cameras})
        < len(cameras)
        == len({camera.stem for camera in cameras if camera.stem})
    ):
        # ROS writes one name into every file
        cameras = [replace(camera, name=camera.stem) for camera in cameras]
    names = [camera.name for camera in cameras]
    if not names:
        content = listed([file.name for file in files]) or "no file"
        raise CaptureError(
            f"{path}: wanted cameras, got {content}, of an unknown form; see docs/your_rig.md for "
            f"the known forms"
        )
    if not all(names) or len(set(names)) < len(names):
        raise CaptureError(
            f"{path}: wanted a calibration with cameras of different names, got {listed(names)}; "
            f"correct the names"
        )
    is_metric = all(camera.is_metric for camera in cameras)
    return CalibrationFile(
        dict(zip(names, cameras, strict=True)), MILLIMETRES if is_metric else None
    )


def load(kind: str, path: Path, units: GivenUnits) -> Capture:
    """Open a folder of videos or images with its calibration file.

    Frames are undistorted as they are read.

    Raises:
        CaptureError: a damaged file, fewer than two of its cameras with frames, or a camera without
            pose.

    Reading:
        Cameras without a pose or frames are left out and noted: a motion-capture studio has cameras
        that see markers alone.
    """
    folder = path if path.is_dir() else path.parent
    file = read_calibration_file(path, kind)
    named = [
        file.cameras,
        {camera.stem: replace(camera, name=camera.stem) for camera in file.cameras.values()},
    ]
    errors = []
    for by_name in named[: 1 + (len(named[1]) == len(named[0]))]:
        try:
            found = find_frames(folder, {name: f"{name}.png" for name in by_name})
            break
        except CaptureError as error:
            reason = str(error).removeprefix(f"{folder}: ")
            errors.append(f"{_find(path, kind)[1][0]}: {reason}{_side_by_side(folder, file)}")
    else:
        raise CaptureError(errors[0])
    file = replace(file, cameras=by_name)
    frames = found.sources
    filmed = [file.cameras[name] for name in frames]
    poses = {
        camera.name: camera.world_to_camera
        for camera in filmed
        if camera.world_to_camera is not None
    }
    placed = [camera for camera in filmed if camera.name in poses]
    if len(placed) < 2:
        remedy = f"'ggvs-eval calibrate {folder} RIG --known-intrinsics {path}' finds them"
        raise CaptureError(
            f"{path}: wanted poses, got only intrinsics of {listed(frames)}; {remedy}"
        )
    rig = []
    for camera in placed:
        try:
            rig.append(
                RigCamera(camera.name, camera.lens(frames[camera.name].size), poses[camera.name])
            )
        except CameraError as error:
            raise CaptureError(f"{path}: {error}") from error
    unplaced = [camera.name for camera in filmed if camera.world_to_camera is None]
    notes = [
        *found.notes,
        *([f"{listed(unplaced)} left out: calibrated, but without a pose"] if unplaced else []),
    ]
    unknown = sorted({key for camera in placed for key in camera.unknown})
    notes += [f"{path.name}: {listed(unknown)} unknown here, ignored"] if unknown else []
    sources = [frames[camera.name] for camera in placed]
    cameras, pinhole = pinhole_rig(rig, sources, path, folder)
    return assemble_capture(
        folder,
        kind,
        cameras,
        pinhole,
        choose_units(folder, units, cameras, of_data_set=file.units),
        notes=notes,
    )


def _side_by_side(folder: Path, file: CalibrationFile) -> str:
    """Hint at pictures that are as wide as those of several cameras; empty where none is."""
    size = next(iter(file.cameras.values())).size
    shown = [ImageFrames(picture).size for picture in list_files_below(folder)[:1]]
    return "".join(
        f"; {describe_crop(frames, size, folder)}"
        for frames in shown
        if size and frames[0] > size[0]
    )


def _find(path: Path, kind: str | None) -> tuple[Callable[[Path], list[FileCamera]], list[Path]]:
    """Return the files of `find_calibration_files`, and what reads them."""
    folders = folders_beside(path) if path.is_dir() else []
    # its folders have poses
    names = [
        name for name in KINDS if kind in (name, None) and (name != "easymocap" or not folders)
    ]
    for kind_of_file in map(KINDS.__getitem__, names):
        for files in [list_entries(folder) for folder in folders] or [[path]]:
            if fitting := [file for file in files if kind_of_file.fits(file)]:
                return kind_of_file.read, fitting
    return lambda _: [], []


def _text(file: Path) -> str:
    """Return the text of a file; none if it cannot be read."""
    try:
        return read_plain_text(file, LARGEST_FILE_BYTES)
    except (OSError, UnicodeDecodeError):
        return ""


QUALISYS_LAYOUT, ANIPOSE_LAYOUT, OPENCV_LAYOUT = (
    DatasetSpec(KINDS[name].describe, partial(refuse, name), partial(load, name))
    for name in ("qualisys", "anipose", "opencv")
)
