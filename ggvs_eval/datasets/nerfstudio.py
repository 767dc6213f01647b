"""Captures of a ``transforms.json`` with one image per fixed camera: nerfstudio's, instant-ngp's,
and NeRF's own split files.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import LARGEST_DEVIATION, pinhole_K
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import SizedSource, assemble_capture, check_rig_size
from ggvs_eval.datasets.camera_frames import find_frames, find_picture
from ggvs_eval.datasets.entries import unknown_entries
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.media import folders_beside
from ggvs_eval.datasets.rig import RigCamera, pinhole_rig
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.names import camera_names, listed, numbers_in
from ggvs_eval.files.plain import read_plain_text
from ggvs_eval.lens import Lens, check_K_size

# One file, or NeRF's one per split, whose cameras are those of one rig; the last are its test
# views.
TRANSFORMS, SPLITS, TEST = "transforms.json", ("train", "val", "test"), "test"
TEST_IMAGES = "test_filenames"  # of one file, nerfstudio's word for a split
FISHEYE_MODEL = "OPENCV_FISHEYE"
MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", FISHEYE_MODEL)
MATRICES = ("K", "intrinsics", "intrinsic_matrix", "camera_intrinsics")
FOCAL_LENGTHS = ("fl_x", "camera_angle_x", "x_fov", "fl_y", "camera_angle_y", "y_fov")
# in the order of time, of a rig that a file lists at several instants
RECORDED = "pictures of a camera"
FRAME_NUMBER = re.compile(r"[_\-. ]+(frame|f|t)?\d+$", re.I)
AXES_LENGTH = "length of the axes"  # of a pose as the file has it
SPLIT = "split of the file"
# OpenGL's camera looks along -z with y up, this package's along +z with y down. instant-ngp reads
# two programs' poses in axes of their own: Mitsuba's camera looks along +z with x to the left,
# NeuS2's has this package's axes.
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
AXES = {"from_mitsuba": np.diag([-1.0, -1.0, 1.0, 1.0]), "from_na": np.eye(4)}
READ = """
    camera_model is_fisheye w h cx cy k1 k2 k3 k4 p1 p2 frames file_path transform_matrix near
    far time test_filenames"""
# Of other programs, and without a say in where a pixel looks: bounds of the scene, other files,
# names and times.
HARMLESS = """
    aabb_scale scale offset aabb render_aabb sharpness ply_file_path applied_transform
    applied_scale orientation_override train_filenames val_filenames colmap_im_id mask_path
    depth_file_path camera_label camera_id cam_id timestamp rotation depth_path
    auto_scale_poses_override auto_scale_poses fps integer_depth_scale frame_id name
    fisheye_crop_radius"""
KNOWN = {
    *MATRICES,
    *FOCAL_LENGTHS,
    *AXES,
    RECORDED,
    AXES_LENGTH,
    SPLIT,
    *READ.split(),
    *HARMLESS.split(),
}


def refuse(path: Path) -> str | None:
    """Return the reason why this is not a nerfstudio capture, or None if it is one."""
    return None if _files(path) else f"neither {TRANSFORMS} nor transforms_{SPLITS[0]}.json"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a capture of a fixed rig.

    Cameras are called as their images or folders, in the order of names.

    Frames are those of `find_frames`: videos or image folders of that name, else the one image
    itself.

    Args:
        path: folder that holds ``transforms.json``, or ``transforms_train.json`` and its like for
            other splits.

    Raises:
        CaptureError: damaged JSON, a camera without pose, intrinsics or frames, or a camera model
            that OpenCV cannot express.

    Reading:
        Cameras of split files are one rig; those of ``transforms_test.json``, or named by
        ``test_filenames``, become its test views. Where pictures of two splits are called alike,
        the split is part of the name: ``train_r_0``, ``test_r_0``. A camera without a picture is
        left out, with a note: some programs list views that they never rendered. Frames of one pose
        are one camera, whose instants are in the order of their times, else of the numbers in their
        names; different times of different poses are refused: they are one camera that moves.
        ``is_fisheye`` is instant-ngp's word for ``OPENCV_FISHEYE``. The size is that of the
        pictures where the file says none, a suffix that of the picture that is there.
    """
    files = _files(path)
    frames = _read_rig(files)
    times = {frame.get("time") for frame in frames.values()}
    if len(times) > 1:
        raise CaptureError(
            f"{files[0]}: wanted all cameras at one instant, got {len(times)} times: a single "
            "camera that moves through a dynamic scene; give videos of several cameras"
        )
    names = sorted(frames)
    notes: list[str] = []
    if any(RECORDED in frame for frame in frames.values()):
        sources: list[SizedSource] = [
            _recorded(path, frames[name].get(RECORDED, [frames[name]["file_path"]]))
            for name in names
        ]
    else:
        found_frames = find_frames(
            path, {name: _image(frames[name]["file_path"]) for name in names}
        )
        notes += found_frames.notes
        names = list(found_frames.sources)
        sources = list(found_frames.sources.values())
    unknown = sorted(
        {key for name in names for key in unknown_entries(files[0], frames[name], KNOWN)}
    )
    notes += (
        [f"{listed(file.name for file in files)}: {listed(unknown)} unknown here, ignored"]
        if unknown
        else []
    )
    rig = [
        _rig_camera(files[0], name, frames[name], source)
        for name, source in zip(names, sources, strict=True)
    ]
    lengths = {
        name: frame[AXES_LENGTH]
        for name, frame in frames.items()
        if abs(frame[AXES_LENGTH] - 1) > 2 * LARGEST_DEVIATION
    }
    if lengths:
        notes.append(
            f"axes of {listed(lengths)} have the length {next(iter(lengths.values())):.4g}: "
            f"brought to 1, places as they are"
        )
    test_views = [
        name
        for name in names
        if frames[name][SPLIT] == TEST
        or frames[name]["file_path"] in frames[name].get(TEST_IMAGES, ())
    ]
    cameras, pinhole = pinhole_rig(rig, sources, files[0], path)
    return assemble_capture(
        path,
        "nerfstudio",
        cameras,
        pinhole,
        choose_units(path, units, cameras),
        notes=notes,
        test_views=test_views,
    )


def _files(path: Path) -> list[Path]:
    for folder in folders_beside(path):
        names = (
            [TRANSFORMS]
            if (folder / TRANSFORMS).is_file()
            else [f"transforms_{split}.json" for split in SPLITS]
        )
        if files := [folder / name for name in names if (folder / name).is_file()]:
            return files
    return []


def _read_rig(files: Sequence[Path]) -> dict[str, dict[str, Any]]:
    """Entries of the cameras of all files by name."""
    described = [frame for file in files for frame in _read_frames(file)]
    names = _names(described)
    if len(set(names)) < len(names) and len(files) > 1:
        names = [f"{frame[SPLIT]}_{PurePosixPath(frame['file_path']).stem}" for frame in described]
    if len(set(names)) < len(names) or not names:
        raise _refused(files[0], ValueError(f"{len(names)} frames of {len(set(names))} cameras"))
    return dict(zip(names, described, strict=True))


def _read_frames(file: Path) -> list[dict[str, Any]]:
    """Entries of the cameras of a file.

    Keys that a frame lacks are taken from the top of the file.
    """
    try:
        values = dict(json.loads(read_plain_text(file)))
        check_rig_size(file, len(values["frames"]))
        defaults = {**values, SPLIT: file.stem.rpartition("_")[2]}
        described = [
            {**defaults, **frame, "file_path": frame["file_path"].replace("\\", "/")}
            for frame in values["frames"]
        ]
        for frame in described:
            frame["transform_matrix"], frame[AXES_LENGTH] = _world_to_camera(frame)
        return _rig_over_time(described)
    except (
        OSError,
        ValueError,
        TypeError,
        KeyError,
        RecursionError,
        AttributeError,
        ArithmeticError,
    ) as error:
        raise _refused(file, error) from error


def _rig_over_time(described: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one entry per camera where a file lists a fixed rig at several instants.

    The entries themselves otherwise.

    Poses tell cameras apart, names do not. An entry keeps the files of its camera, in the order of
    time.
    """
    by_pose: dict[bytes, list[dict[str, Any]]] = {}
    for frame in described:
        by_pose.setdefault(np.round(frame["transform_matrix"], 6).tobytes(), []).append(frame)
    if len(by_pose) == len(described) or len({frame["file_path"] for frame in described}) < len(
        described
    ):
        return described
    groups = [_in_time(group) for group in by_pose.values()]
    times = {tuple(frame.get("time") for frame in group) for group in groups}
    if len({len(group) for group in groups}) > 1 or len(times) > 1:
        return described
    return [
        {**group[0], "time": None, RECORDED: [frame["file_path"] for frame in group]}
        for group in groups
    ]


def _in_time(group: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the frames of one camera by their times, else by the numbers in their names, else as
    they are.
    """
    if all("time" in frame for frame in group):
        return sorted(group, key=lambda frame: float(frame["time"]))
    numbers = numbers_in([frame["file_path"].rpartition(".")[0] for frame in group])
    places = {frame["file_path"]: number or 0 for frame, number in zip(group, numbers, strict=True)}
    return (
        list(group)
        if None in numbers
        else sorted(group, key=lambda frame: places[frame["file_path"]])
    )


def _names(described: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the cameras' names, those of a rig over time without the number of the instant."""
    names = camera_names([frame["file_path"] for frame in described])
    if described and RECORDED in described[0]:
        bare = [FRAME_NUMBER.sub("", name) for name in names]
        names = bare if all(bare) and len(set(bare)) == len(bare) else names
    return names


def _recorded(path: Path, file_paths: Sequence[str]) -> ImageFrames:
    """Return the pictures of a camera in the order of time, which are all there."""
    files = []
    for file_path in file_paths:
        file = find_picture(path, _image(file_path)) or find_picture(
            path / "images", _image(file_path)
        )
        if file is None:
            raise CaptureError(
                f"{path}: wanted the picture {file_path} of {TRANSFORMS}, got no such file; "
                f"restore it"
            )
        files.append(file)
    return ImageFrames(path, numbered=tuple(enumerate(files)))


def _image(file_path: str) -> str:
    """Return the picture of a frame as `find_frames` looks for it."""
    return file_path.removeprefix("./").removeprefix("images/")


def _rig_camera(file: Path, name: str, frame: Mapping[str, Any], source: SizedSource) -> RigCamera:
    try:
        near_far = (
            (float(frame["near"]), float(frame["far"])) if {"near", "far"} <= frame.keys() else None
        )
        return RigCamera(
            name=name,
            lens=_lens(frame, source.size),
            world_to_camera=frame["transform_matrix"],
            near_far=near_far,
        )
    except CameraError as error:
        raise CaptureError(
            f"{file}: wanted frames with poses and intrinsics, {name}: {error}"
        ) from error
    except (ValueError, TypeError, KeyError, ArithmeticError) as error:
        raise _refused(file, error) from error


def _refused(file: Path, error: Exception) -> CaptureError:
    reason = f"no {error}" if isinstance(error, KeyError) else str(error)
    return CaptureError(
        f"{file}: wanted frames with poses and intrinsics, one per camera, got: {reason:.200}; "
        f"export it again"
    )


def _world_to_camera(frame: Mapping[str, Any]) -> tuple[Array, float]:
    """The pose of a frame, its axes brought to length 1 if all have one length, as instant-ngp
    does; and that length.
    """
    camera_to_world = np.array(frame["transform_matrix"], dtype=np.float64)
    if camera_to_world.shape != (4, 4) or not np.isfinite(camera_to_world).all():
        raise ValueError(
            f"the transform_matrix of {frame['file_path']} is not 4 x 4 finite numbers"
        )
    scale = np.linalg.norm(camera_to_world[:3, :3], axis=0)
    is_scaled = not np.allclose(scale, 1.0, atol=2 * LARGEST_DEVIATION)
    if is_scaled and scale.min() > 0 and np.ptp(scale) <= LARGEST_DEVIATION * scale.min():
        camera_to_world[:3, :3] /= scale.mean()
        is_scaled = False
    if is_scaled or not np.array_equal(camera_to_world[3], (0, 0, 0, 1)):
        defects = (
            f"axes of length {', '.join(f'{length:.4g}' for length in scale)}, last row "
            f"{camera_to_world[3].tolist()}"
        )
        raise ValueError(f"the transform_matrix of {frame['file_path']} is not rigid ({defects})")
    axes = next((AXES[key] for key in AXES if frame.get(key)), OPENGL_TO_OPENCV)
    return np.asarray(np.linalg.inv(camera_to_world @ axes), dtype=np.float64), float(scale.mean())


def _lens(frame: Mapping[str, Any], frame_size: tuple[int, int]) -> Lens:
    """Return the lens of a frame, whose picture has that size."""
    width, height = int(frame.get("w", frame_size[0])), int(frame.get("h", frame_size[1]))
    is_fisheye = bool(frame.get("is_fisheye"))
    model = frame.get("camera_model", FISHEYE_MODEL if is_fisheye else "OPENCV")
    if model not in MODELS:
        raise CameraError(
            f"camera_model {model!r:.40}, known are {', '.join(MODELS)}; undistort the images first"
        )
    if is_fisheye != (model == FISHEYE_MODEL) and "is_fisheye" in frame:
        raise ValueError(
            f"is_fisheye {frame['is_fisheye']!r:.20} of camera_model {model}; keep the one that is "
            f"right"
        )
    if model != FISHEYE_MODEL and frame.get("k4", 0):
        raise ValueError(
            f"k4 = {frame['k4']!r:.40} of {model}, which programs read differently; undistort the "
            f"images"
        )
    names = ("k1", "k2", "k3", "k4") if model == FISHEYE_MODEL else ("k1", "k2", "p1", "p2", "k3")
    coefficients = tuple(float(frame.get(name, 0.0)) for name in names)
    K = _intrinsics(frame, width, height)
    check_K_size(K, (width, height), is_stated={"w", "h"} <= frame.keys())
    return Lens(
        K=K,
        model="fisheye" if model == FISHEYE_MODEL else "opencv",
        coefficients=coefficients,
        width=width,
        height=height,
    )


def _intrinsics(frame: Mapping[str, Any], width: int, height: int) -> Array:
    """K by a matrix, focal lengths or angles of view, (3, 3).

    One of two focal lengths is that of square pixels.
    """
    focal = {}
    for axis, side in (("x", width), ("y", height)):
        if f"fl_{axis}" in frame:
            focal[axis] = float(frame[f"fl_{axis}"])
        elif f"camera_angle_{axis}" in frame:
            focal[axis] = side / 2 / math.tan(float(frame[f"camera_angle_{axis}"]) / 2)
        elif f"{axis}_fov" in frame:
            focal[axis] = side / 2 / math.tan(math.radians(float(frame[f"{axis}_fov"])) / 2)
    matrix = next(
        (np.array(frame[key], dtype=np.float64) for key in MATRICES if key in frame), None
    )
    if matrix is not None and (matrix.ndim != 2 or min(matrix.shape) < 3):
        raise ValueError(
            f"intrinsics of {frame['file_path']} of shape {matrix.shape}, wanted 3 x 3"
        )
    if matrix is not None and not focal:
        return matrix[:3, :3].copy()
    if not focal:
        raise KeyError("fl_x, camera_angle_x, x_fov or K")
    lengths_px = list(focal.values())  # of x and y, or one for both
    K = pinhole_K(
        lengths_px[0],
        lengths_px[-1],
        float(frame.get("cx", width / 2)),
        float(frame.get("cy", height / 2)),
    )
    if matrix is not None and not np.allclose(matrix[:3, :3], K, rtol=1e-3, atol=0.1):
        raise ValueError(
            f"two intrinsics of {frame['file_path']}, a matrix {np.round(matrix, 4)} and "
            f"{np.round(K, 4)}; keep the right one"
        )
    return K


LAYOUT = DatasetSpec(
    describe="transforms.json, or one per split, with one image per camera",
    refuse=refuse,
    load=load,
    marks=("transforms*.json",),
)
