"""A rig of your own: ``capture.toml`` lists the frames and the calibration of every camera."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, Extras
from ggvs_eval.datasets.assemble import (
    Crop,
    SizedSource,
    assemble_capture,
    check_rig_size,
    crop_lens,
    given_crop,
)
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.rig import RigCamera, pinhole_rig, undistorted
from ggvs_eval.datasets.units import GivenUnits, Units, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.listing import UNREAD_VIDEOS, VIDEO_SUFFIXES, find_below, unread_videos
from ggvs_eval.files.toml_tables import build_table, read_toml
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.lens import PIXEL_CENTRE, Lens, LensModel

FILE = "capture.toml"
Numbers = tuple[float, ...]
Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class LensTable:
    """``distortion`` of a camera.

    Attributes:
        model: ``opencv`` or ``fisheye``.
    """

    model: LensModel
    coefficients: Numbers


@dataclass(frozen=True)
class CameraTable:
    """One ``[[camera]]``.

    Attributes:
        frames: video, folder of images or image, relative to the file.
        K: intrinsics, 3 x 3, pixels.
        width: of the images the calibration was made for.
        world_to_camera: 4 x 4; this or camera_to_world.
        camera_to_world: 4 x 4.
        distortion: of the lens; none if absent.
        near: smallest depth of the scene, world units; with far, or neither.
        far: largest depth of the scene, world units.
        crop: column and row of the calibrated picture that the frames begin with, where they are a
            part of it.
        background: image of the scene without what moves.
        mask: masks of the foreground, one per frame: a video or a folder of images.
    """

    name: str
    frames: str
    K: Matrix
    width: int
    height: int
    world_to_camera: Matrix | None = None
    camera_to_world: Matrix | None = None
    distortion: LensTable | None = None
    near: float | None = None
    far: float | None = None
    crop: tuple[int, ...] | None = None
    background: str | None = None
    mask: str | None = None


@dataclass(frozen=True)
class CaptureTable:
    """The whole file.

    Attributes:
        camera: the rig, in this order.
        scene: what the scene is called; the folder's name by default.
        fps: frames per second where the frames are images.
        pixel_centre: position of the centre of the first pixel in the file's K: ``half`` (COLMAP)
            or ``whole`` (OpenCV).
    """

    camera: tuple[CameraTable, ...]
    scene: str | None = None
    fps: float | None = None
    units_per_metre: float | None = None
    pixel_centre: Literal["half", "whole"] = "half"


def refuse(path: Path) -> str | None:
    """Return the reason why this is not a capture.toml, or None if it is one."""
    return None if _file(path).is_file() else f"no {FILE}"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a rig described by ``capture.toml``, the file itself or its folder.

    Reading:
        Frames of a distorting lens are undistorted to the K of `Lens.undistorted_K`, in which no
        pixel is blank.
    """
    file = _file(path)
    table = build_table(CaptureTable, read_toml(file, CaptureError), str(file), "", CaptureError)
    check_rig_size(file, len(table.camera))
    poses = [_pose(camera, file) for camera in table.camera]
    if not poses:
        raise CaptureError(
            f"{file}: wanted at least one [[camera]], got none; describe the rig, see "
            f"docs/captures.md"
        )
    for key, value in (("fps", table.fps), ("units_per_metre", table.units_per_metre)):
        if value is not None and value <= 0:
            raise CaptureError(f"{file}: {key} must be positive, got {value:g}; correct or drop it")
    frames = [_source(file, camera.frames) for camera in table.camera]
    crop = given_crop(file.parent)
    rig = []
    for camera, pose, source in zip(table.camera, poses, frames, strict=True):
        lens = _lens(
            file, camera, source.size, PIXEL_CENTRE if table.pixel_centre == "whole" else 0.0, crop
        )
        rig.append(
            RigCamera(
                name=camera.name, lens=lens, world_to_camera=pose, near_far=_near_far(file, camera)
            )
        )
    cameras, sources = pinhole_rig(rig, frames, file, file.parent)
    extras = [
        _extras(file, *row)
        for row in zip(table.camera, [view.lens for view in rig], cameras, sources, strict=True)
    ]
    table_units = None if table.units_per_metre is None else Units(table.units_per_metre, FILE)
    scale = choose_units(file.parent, units, cameras, of_data_set=table_units)
    fps = None if any(isinstance(source, VideoFrames) for source in sources) else table.fps
    return assemble_capture(
        file.parent,
        "capture.toml",
        cameras,
        sources,
        scale,
        scene=table.scene,
        fps=fps,
        extras=extras,
    )


def _file(path: Path) -> Path:
    return (
        path / FILE
        if path.is_dir()
        else path
        if path.name == FILE
        else path.with_name(FILE + ".absent")
    )


def _pose(camera: CameraTable, file: Path) -> Array:
    matrices = [
        matrix for matrix in (camera.world_to_camera, camera.camera_to_world) if matrix is not None
    ]
    if len(matrices) != 1:
        raise CaptureError(
            f"{file}: camera {camera.name} wants one of world_to_camera and camera_to_world, got "
            f"{len(matrices)}"
        )
    pose = as_matrix(matrices[0], 4, f"{file}: pose of {camera.name}")
    if not np.array_equal(pose[3], (0, 0, 0, 1)):
        last_row = f"{pose[3].tolist()}; transpose it where points are rows"
        raise CaptureError(
            f"{file}: the last row of the pose of {camera.name} must be 0 0 0 1, got {last_row}"
        )
    if camera.world_to_camera is not None:
        return pose
    if not 1e-9 < abs(np.linalg.det(pose)) < 1e9:
        raise CaptureError(
            f"{file}: camera_to_world of {camera.name} cannot be inverted; correct it"
        )
    return np.asarray(np.linalg.inv(pose), dtype=np.float64)


def as_matrix(rows: Matrix, size: int, subject: str) -> Array:
    """Return rows of as many numbers as a square array; `subject` is named in errors."""
    if [len(row) for row in rows] != [size] * size:
        raise CaptureError(
            f"{subject} must be {size} rows of {size} numbers, got rows of "
            f"{[len(row) for row in rows]}"
        )
    return np.array(rows, dtype=np.float64)


def _lens(
    file: Path, camera: CameraTable, frames: tuple[int, int], shift_px: float, crop: Crop | None
) -> Lens:
    """Return the lens of the frames: where they are a part of the calibrated picture, of
    that part.
    """
    if camera.crop is not None and len(camera.crop) != 2:
        raise CaptureError(
            f"{file}: camera {camera.name}: wanted crop = [column, row], got {list(camera.crop)}; "
            f"correct it"
        )
    K = as_matrix(camera.K, 3, f"{file}: K of {camera.name}")
    K[:2, 2] += shift_px
    table = camera.distortion or LensTable("opencv", (0.0,) * 4)
    try:
        lens = Lens(
            K=K,
            model=table.model,
            coefficients=table.coefficients,
            width=camera.width,
            height=camera.height,
        )
        return crop_lens(camera.name, lens, frames, Crop(*camera.crop) if camera.crop else crop)
    except CameraError as error:
        raise CaptureError(f"{file}: camera {camera.name}: {error}") from error


def _near_far(file: Path, camera: CameraTable) -> tuple[float, float] | None:
    if (camera.near is None) != (camera.far is None):
        raise CaptureError(
            f"{file}: camera {camera.name} wants near and far or neither; add the other"
        )
    return None if camera.near is None or camera.far is None else (camera.near, camera.far)


def _source(file: Path, relative: str) -> SizedSource:
    try:
        path = find_below(file.parent, relative)
        is_there = bool(relative) and path.exists()
    except OSError:  # a name too long for the file system
        is_there = False
    if not is_there:
        raise CaptureError(
            f"{file}: wanted frames in {relative!r:.200}, there is no such file or folder; correct "
            f"the path"
        )
    if path.is_file() and path.suffix.lower() in UNREAD_VIDEOS:
        raise CaptureError(
            f"{file}: {unread_videos(path.parent, (path.stem,))}, and name that file"
        )
    return (
        VideoFrames(path)
        if not path.is_dir() and path.suffix.lower() in VIDEO_SUFFIXES
        else ImageFrames(path)
    )


def _extras(
    file: Path, table: CameraTable, lens: Lens, camera: Camera, frames: SizedSource
) -> Extras:
    sources = [
        undistorted(_source(file, name), lens, camera.K) if name else None
        for name in (table.background, table.mask)
    ]
    background, mask = sources
    if mask is not None and mask.n_frames != frames.n_frames:
        counts = f"{mask.n_frames} for {frames.n_frames} frames"
        raise CaptureError(
            f"{file}: wanted one mask of {table.name} per frame, got {counts}; restore them or "
            f"drop the key"
        )
    return Extras(background=background, mask=mask)


LAYOUT = DatasetSpec("capture.toml, a rig of your own", refuse, load)
