"""Calibrations as other tools write them: Qualisys' ``.qca.txt``, the TOML of anipose, freemocap
and caliscope, OpenCV's files.

Facts of the formats: Qualisys writes 64ths of a pixel and millimetres, as pose2sim reads them;
aniposelib what OpenCV calibrates.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import rigid
from ggvs_eval.datasets.assemble import Crop, crop_lens
from ggvs_eval.datasets.entries import plain_numbers, unknown_entries
from ggvs_eval.datasets.filestorage_yaml import (
    FileStorageYaml,
    parse_xml,
    read_camera_text,
    refused,
)
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.plain import comma_hint, read_plain_text
from ggvs_eval.files.toml_tables import read_toml
from ggvs_eval.lens import PIXEL_CENTRE, Lens, LensModel, check_K_size

LARGEST_NUMBER = 1e9
SUBPIXELS, MM_PER_M = 64.0, 1000.0
# Qualisys' camera looks along its -z with y up, OpenCV's along z with y down.
QUALISYS_AXES: Array = np.diag([1.0, -1.0, -1.0])
# of its metadata, in millimetres, and so is all that was calibrated with it
FREEMOCAP_KEY = "charuco_square_size"
# What stereo calibrations call their two cameras' K and distortion; the first is that of OpenCV's
# own sample.
STEREO_KEYS = (("M{}", "D{}"), ("K{}", "D{}"), ("cameraMatrix{}", "distCoeffs{}"))
MATRIX_KEYS = ("camera_matrix", "Camera_Matrix", "cameraMatrix")
DISTORTION_KEYS = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distCoeffs",
    "dist_coeffs",
    "dist_coeff",
)
WIDTH_KEYS, HEIGHT_KEYS = ("image_width", "image_Width"), ("image_height", "image_Height")
# What ROS and others call the two models under distortion_model.
ROS_FISHEYE, ROS_RADIAL = (
    ("equidistant", "fisheye"),
    ("", "plumb_bob", "rational_polynomial", "radtan", "opencv"),
)
STEREO_NAMES, STEREO_EXTRINSICS = ("left", "right"), "extrinsics.yml"
ROTATION_KEYS, TRANSLATION_KEYS = (
    ("R", "rvec", "rotation_matrix", "rotation_vector"),
    ("T", "tvec", "translation_vector"),
)

# Entries that are read, and those that have no say in where a pixel looks: boards, flags, errors,
# rectification.
BOARD_ENTRIES = """
    names camera_name fisheye_model distortion_model calibration_time board_width board_height
    square_size marker_size aspectRatio aspect_ratio flags nframes nr_of_frames nrOfFrames
    avg_reprojection_error Avg_Reprojection_Error per_view_reprojection_errors
    extrinsic_parameters image_points grid_points rectification_matrix projection_matrix R1 R2
    P1 P2 Q E F rms"""
OPENCV_KEYS = {
    *MATRIX_KEYS,
    *DISTORTION_KEYS,
    *WIDTH_KEYS,
    *HEIGHT_KEYS,
    *ROTATION_KEYS,
    *TRANSLATION_KEYS,
}
OPENCV_KEYS |= {key.format(number) for keys in STEREO_KEYS for key in keys for number in (1, 2)} | {
    *BOARD_ENTRIES.split()
}
TOML_ENTRIES = """
    name size matrix distortions rotation translation fisheye ignore cam_id port error
    grid_count rotation_count exposure verified fps backend model"""
TOML_KEYS = {*TOML_ENTRIES.split()}
QUALISYS_ENTRIES = """
    focalLengthU focalLengthV centerPointU centerPointV sensorMinU sensorMinV sensorMaxU
    sensorMaxV focallength radialDistortion1 radialDistortion2 radialDistortion3
    tangentalDistortion1 tangentalDistortion2"""
QUALISYS_KEYS = {*QUALISYS_ENTRIES.split()}


@dataclass(frozen=True, eq=False)
class FileCamera:
    """One camera of a calibration file.

    Attributes:
        name: as the file calls it.
        K: intrinsics in pixels, (3, 3), pixel centres at halves.
        size: (width, height) of the calibrated images; None if the file does not say.
        world_to_camera: (4, 4); None if only the lens is known.
        is_metric: whether the pose is known to be in metres.
        stem: what the file is called; empty if it is of several cameras.
        unknown: entries of the file that were passed over.
        near_far: depth range, world units; None if the file does not say.
    """

    name: str
    K: Array
    model: LensModel
    coefficients: tuple[float, ...]
    size: tuple[int, int] | None
    world_to_camera: Array | None
    is_metric: bool = False
    stem: str = ""
    unknown: Sequence[str] = ()
    near_far: tuple[float, float] | None = None

    def lens(self, frame_size: tuple[int, int] | None, crop: Crop | None = None) -> Lens:
        """Return the lens at the size of the calibration, which is taken to be that of the frames
        where the file names none.

        Args:
            frame_size: (width, height) of the frames, pixels.
            crop: where frames of another shape begin in the calibrated picture; the lens is that of
                the frames then.

        Raises:
            CameraError: neither size is known, it is no lens, or no part of it.
        """
        size = self.size or frame_size
        if size is None:
            raise CameraError(
                f"wanted the size of the images {self.name} was calibrated for, the file names "
                f"none; add it"
            )
        lens = Lens(self.K, self.model, self.coefficients, *size)
        check_K_size(self.K, size, is_stated=self.size is not None)
        return crop_lens(self.name, lens, frame_size, crop) if frame_size else lens


def read_qualisys(path: Path) -> list[FileCamera]:
    """Read the cameras of a ``.qca.txt``, an XML file of Qualisys Track Manager; in metres.

    Reading:
        The rows r11 r12 r13, ... of ``transform`` are the camera's axes right, up and backwards in
        the world, x y z its centre. Numbers of ``intrinsic`` are 64ths of a pixel of the whole
        sensor, of which the video is the part ``fov_video``; its principal point counts from the
        first pixel's centre like OpenCV's. Distortion is OpenCV's, of normalised coordinates:
        pose2sim divides it by 64 too, which makes it vanish. ``viewrotation`` is not applied;
        frames must have the shape of ``fov_video``.
    """
    cameras = []
    text = read_camera_text(path, "a Qualisys calibration")
    for element in parse_xml(path, text, "the XML of a Qualisys calibration").iter("camera"):
        name = element.get("serial") or ""
        transform, inner, view = (
            _xml_numbers(path, element, tag) for tag in ("transform", "intrinsic", "fov_video")
        )
        rows = [[transform(f"r{row}{column}") for column in (1, 2, 3)] for row in (1, 2, 3)]
        rotation = QUALISYS_AXES @ np.array(rows)
        centre = np.array([transform(axis) for axis in "xyz"]) / MM_PER_M
        K = np.eye(3)
        for row, (axis, edge) in enumerate((("U", "left"), ("V", "top"))):
            K[row, row] = inner(f"focalLength{axis}") / SUBPIXELS
            K[row, 2] = inner(f"centerPoint{axis}") / SUBPIXELS - view(edge) + PIXEL_CENTRE
        keys = [f"{kind}Distortion{index}" for kind in ("radial", "tangental") for index in (1, 2)]
        coefficients = (*map(inner, keys), inner("radialDistortion3", 0.0))
        size = (round(view("right") - view("left")) + 1, round(view("bottom") - view("top")) + 1)
        intrinsic = element.find("intrinsic")
        unknown = unknown_entries(
            path, {} if intrinsic is None else intrinsic.attrib, QUALISYS_KEYS
        )
        pose = rigid(rotation, -rotation @ centre)
        cameras.append(
            FileCamera(
                name=name,
                K=K,
                model="opencv",
                coefficients=coefficients,
                size=size,
                world_to_camera=pose,
                is_metric=True,
                unknown=unknown,
            )
        )
    return cameras


def read_anipose(path: Path) -> list[FileCamera]:
    """Read the cameras of a TOML file of anipose, freemocap, pose2sim or caliscope.

    Reading:
        freemocap notes the size of its board in millimetres, so its poses become metres. The unit
        of others depends on the size of their board, which they do not state. caliscope's cameras,
        a table of tables, are called as it calls their videos: ``cam_0``, or ``port_0`` before;
        those that it ignores are left out.
    """
    values = read_toml(path, CaptureError) if path.suffix.lower() == ".toml" else _json_tables(path)
    metadata = values.get("metadata")
    is_freemocap = isinstance(metadata, dict) and FREEMOCAP_KEY in metadata
    tables = {
        key: table for key, table in values.items() if isinstance(table, dict) and "matrix" in table
    }
    # caliscope's cameras are together in one table
    for group in values.values() if not tables else ():
        inner = group if isinstance(group, dict) else {}
        tables |= {
            key: table
            for key, table in inner.items()
            if isinstance(table, dict) and "matrix" in table
        }
    cameras = []
    for key, table in tables.items():
        if table.get("ignore") is True:
            continue
        K = _numbers(path, key, table, "matrix", (3, 3))
        K[:2, 2] += PIXEL_CENTRE
        coefficients = (
            _numbers(path, key, table, "distortions", None)
            if table.get("distortions")
            else np.zeros(5)
        )
        size = (
            None
            if "size" not in table
            else _size(path, key, _numbers(path, key, table, "size", (2,)))
        )
        pose = None
        if _is_given(table, "rotation") or _is_given(table, "translation"):
            translation = _numbers(path, key, table, "translation", (3,)) / (
                MM_PER_M if is_freemocap else 1.0
            )
            shape = (3, 3) if np.ndim(table.get("rotation", ())) == 2 else (3,)
            pose = rigid(_rotation(_numbers(path, key, table, "rotation", shape)), translation)
        model: LensModel = "fisheye" if table.get("fisheye") is True else "opencv"
        unknown = unknown_entries(path, table, TOML_KEYS)
        name = _table_name(key, table)
        cameras.append(
            FileCamera(
                name=name,
                K=K,
                model=model,
                coefficients=tuple(map(float, coefficients)),
                size=size,
                world_to_camera=pose,
                is_metric=is_freemocap,
                unknown=unknown,
            )
        )
    return cameras


def _json_tables(path: Path) -> dict[str, Any]:
    """Return the tables of a list of cameras in JSON, as AIST++ keeps aniposelib's.

    None of anything else.
    """
    try:
        values = json.loads(read_plain_text(path))
    except (OSError, ValueError, RecursionError):
        return {}
    return (
        {str(index): table for index, table in enumerate(values)}
        if isinstance(values, list)
        else {}
    )


def _is_given(table: Mapping[str, Any], key: str) -> bool:
    """Return whether a key has a value; caliscope writes "null" for unknown values."""
    return table.get(key) not in (None, "null", [])


def _table_name(key: str, table: Mapping[str, Any]) -> str:
    """Return the name of a camera: that in its table, caliscope's for its videos, or the table's
    own.
    """
    numbered = next(
        (
            f"{word}_{table[at]}"
            for word, at in (("cam", "cam_id"), ("port", "port"))
            if at in table
        ),
        key,
    )
    return str(table.get("name", numbered))


def read_opencv(path: Path) -> list[FileCamera]:
    """Read a YAML or XML file of cv2.FileStorage, or ROS' YAML: one camera, or the two of a stereo
    calibration.

    One camera has ``camera_matrix`` and ``distortion_coefficients``, perhaps ``image_width``,
    ``image_height``, ``fisheye_model`` or ROS' ``distortion_model``, and its pose as ``R``, ``T``
    or ``rvec``, ``tvec``; it is called ``camera_name`` or like the file. Two have ``M1 D1 M2 D2``
    (or ``K1``, ``cameraMatrix1``, ...) with ``R`` and ``T`` in the same file or in
    ``extrinsics.yml`` next to it; they are called by ``names``, or left and right, and the first is
    the world.
    """
    file = FileStorageYaml(path, is_plain=True)
    single = next((key for key in MATRIX_KEYS if file.has(key)), None)
    if single is not None:
        name = file.text("camera_name") or path.stem
        distortion = next((key for key in DISTORTION_KEYS if file.has(key)), DISTORTION_KEYS[0])
        return [
            replace(
                _opencv_camera(file, name, single, distortion, _opencv_pose(file)), stem=path.stem
            )
        ]
    keys = next((keys for keys in STEREO_KEYS if file.has(keys[0].format(1))), None)
    if keys is None:
        raise refused(path, "camera_matrix of a camera, or M1 and M2 of a stereo pair", "neither")
    beside = path.with_name(STEREO_EXTRINSICS)
    pose = (
        _opencv_pose(file)
        if file.has("R") or not beside.exists()
        else _opencv_pose(FileStorageYaml(beside))
    )
    names = file.texts("names") if len(file.texts("names")) == len(STEREO_NAMES) else STEREO_NAMES
    poses = (np.eye(4) if pose is not None else None, pose)
    if not file.has("fisheye_model") and not file.has("distortion_model"):
        _check_stereo_coefficients(file, path, keys[1])
    return [
        _opencv_camera(file, name, keys[0].format(number), keys[1].format(number), pose_of_camera)
        for number, (name, pose_of_camera) in enumerate(zip(names, poses, strict=True), 1)
    ]


def _check_stereo_coefficients(file: FileStorageYaml, path: Path, key: str) -> None:
    """Refuse four coefficients, as cv::fisheye::stereoCalibrate writes them and as k1 k2 p1 p2 are,
    unless a key says which.
    """
    counts = [
        file.matrix(key.format(number), None).size
        for number in (1, 2)
        if file.has(key.format(number))
    ]
    if 4 in counts:
        raise CaptureError(
            f"{path}: wanted five or more coefficients, as cv::stereoCalibrate writes them, or a "
            f"key that says what four mean, got four in {key.format(1)} and {key.format(2)}; add "
            "'fisheye_model: 1' where they are of cv::fisheye, else 'fisheye_model: 0'"
        )


def _opencv_camera(
    file: FileStorageYaml, name: str, matrix: str, distortion: str, pose: Array | None
) -> FileCamera:
    K = file.matrix(matrix, (3, 3))
    K[:2, 2] += PIXEL_CENTRE
    coefficients = file.matrix(distortion, None).ravel() if file.has(distortion) else np.zeros(5)
    width, height = (
        next((file.number(key) for key in keys if file.has(key)), None)
        for keys in (WIDTH_KEYS, HEIGHT_KEYS)
    )
    size = (round(width), round(height)) if width and height else None
    is_fisheye = (
        file.text("fisheye_model") not in ("", "0", "false")
        or file.text("distortion_model") in ROS_FISHEYE
    )
    if file.text("distortion_model") not in (*ROS_FISHEYE, *ROS_RADIAL):
        models = ", ".join((*ROS_RADIAL[1:], *ROS_FISHEYE))
        raise CaptureError(
            f"{file.path}: wanted a distortion_model of {models}, got "
            f"{file.text('distortion_model'):.40}; undistort the frames "
            "first"
        )
    unknown = unknown_entries(file.path, file.entries, OPENCV_KEYS)
    model: LensModel = "fisheye" if is_fisheye else "opencv"
    return FileCamera(
        name=name,
        K=K,
        model=model,
        coefficients=tuple(map(float, coefficients)),
        size=size,
        world_to_camera=pose,
        unknown=unknown,
    )


def _opencv_pose(file: FileStorageYaml) -> Array | None:
    rotation = next((key for key in ROTATION_KEYS if file.has(key)), None)
    translation = next((key for key in TRANSLATION_KEYS if file.has(key)), None)
    if rotation is None or translation is None:
        return None
    shape = (3, 3) if len(file.matrix(rotation, None).ravel()) == 9 else (3, 1)
    return rigid(_rotation(file.matrix(rotation, shape)), file.matrix(translation, (3, 1)).ravel())


def _rotation(values: Array) -> Array:
    """Return a rotation matrix of itself, or of Rodrigues' vector."""
    return (
        values
        if values.shape == (3, 3)
        else np.asarray(cv2.Rodrigues(values.reshape(3, 1))[0], np.float64)
    )


def _xml_numbers(path: Path, camera: ElementTree.Element, tag: str) -> Any:
    """Return a reader of the numbers of an element of a camera, by their key."""
    element = camera.find(tag)

    def number(key: str, default: float | None = None) -> float:
        text = None if element is None else element.get(key)
        if text is None and default is not None:
            return default
        try:
            value = float(text or "")
        except ValueError:
            value = float("nan")
        if not abs(value) < LARGEST_NUMBER:
            raise refused(
                path,
                f"a number {key} in {tag} of camera {camera.get('serial')}",
                f"{text!r}{comma_hint(text or '')}",
            )
        return value

    return number


def _numbers(
    path: Path, section: str, table: Mapping[str, Any], key: str, shape: tuple[int, ...] | None
) -> Array:
    """Return the numbers of a key as an array of this shape, of any length where None."""
    values = plain_numbers(table.get(key))
    is_shaped = values.ndim > 0 if shape is None else values.shape == shape
    if not is_shaped or not values.size or not (np.abs(values) < LARGEST_NUMBER).all():
        size = "numbers" if shape is None else f"{' x '.join(map(str, shape))} numbers"
        raise refused(path, f"{size} in {section}.{key}", repr(table.get(key))[:80])
    return values if shape else values.ravel()


def _size(path: Path, section: str, values: Array) -> tuple[int, int]:
    if not (values >= 1).all():
        raise refused(path, f"a positive {section}.size", str(values.tolist()))
    return round(values[0]), round(values[1])
