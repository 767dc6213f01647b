"""LLFF pose files (``poses_bounds.npy``), N x 17 numbers in LLFF's axes, and captures that are
calibrated by one.

DyNeRF / Neural 3D Video: ``camXX.mp4``, and the frame folders other code makes of them. MeetRoom
(StreamRF, Li et al., NeurIPS 2022): ``cam_<N>.mp4``, or a folder per instant.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, pinhole_K, rigid
from ggvs_eval.capture import Capture, Extras
from ggvs_eval.datasets.assemble import SizedSource, assemble_capture, check_rig_size
from ggvs_eval.datasets.camera_frames import backgrounds
from ggvs_eval.datasets.find_cameras import find_marked
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.media import CameraFrames, members
from ggvs_eval.datasets.units import GivenUnits, choose_units, read_note
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.array_file import read_numbers
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.files.listing import unread_videos
from ggvs_eval.files.names import listed
from ggvs_eval.kernels.portable import transformed

# What is beyond is damage, and no square of it is finite.
LARGEST_NUMBER = 1e100
POSES = "poses_bounds.npy"
CAMERA_NAME = r"(?:cam)?\d+"
FRAMES = ("", "frames/")


class LlffPose(NamedTuple):
    """One row of a pose file, in OpenCV axes.

    Attributes:
        world_to_camera: rigid transform, (4, 4).
        hwf: height, width and focal length in pixels of the images the poses were made for.
        near: smallest depth of the scene, world units.
        far: largest depth of the scene, world units.
    """

    world_to_camera: Array
    hwf: tuple[float, float, float]
    near: float
    far: float


def read_llff_poses(path: Path) -> list[LlffPose]:
    """Read a pose file.

    Args:
        path: ``poses_bounds.npy``. A row holds a 3 x 5 matrix [r0 r1 r2 | t | hwf] with the
            camera's axes in the world in the order down, right, backwards, its centre t, and then
            near and far.

    Raises:
        CaptureError: absent, no plain array of numbers, not N x 17, or a row that is not finite.
    """
    rows = read_numbers(path, (None, 17), "an N x 17 array of numbers (LLFF)")
    check_rig_size(path, len(rows))
    spoilt = np.flatnonzero(~(np.abs(rows) < LARGEST_NUMBER).all(axis=1))
    if spoilt.size:
        numbers = ", ".join(map(str, spoilt))
        raise CaptureError(
            f"{path}: wanted finite numbers, got NaN or infinity in row {numbers} (from 0); "
            f"calibrate again"
        )
    return [_from_row(row) for row in rows]


def write_llff_poses(path: Path, poses: Sequence[LlffPose]) -> None:
    """Write a pose file that `read_llff_poses` reads back.

    It appears under its name when it is whole.
    """
    rows = np.stack([_to_row(pose) for pose in poses])  # (N, 17)
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.save(file, rows)


def llff_pose(camera: Camera) -> LlffPose:
    """Return the row of a camera.

    Its principal point is taken to be the image centre and its focal length the mean of both.
    """
    return LlffPose(
        world_to_camera=camera.world_to_camera,
        hwf=(camera.height, camera.width, camera.focal_px),
        near=camera.near,
        far=camera.far,
    )


def llff_camera(pose: LlffPose, name: str, path: Path) -> Camera:
    """Return the camera of a row, at the size the poses were made for.

    `path` is the file named in errors.
    """
    height, width, focal_px = pose.hwf
    try:
        K = pinhole_K(focal_px, focal_px, width / 2, height / 2)
        return Camera(
            name=name,
            K=K,
            world_to_camera=pose.world_to_camera,
            width=round(width),
            height=round(height),
            near=pose.near,
            far=pose.far,
        )
    except CameraError as error:
        raise CaptureError(f"{path}: {error}") from error


def _from_row(row: Array) -> LlffPose:
    down, right, backwards, centre, hwf = row[:15].reshape(3, 5).T
    # (3, 3), rows are the camera's axes in the world
    rotation = np.stack([right, down, -backwards])
    height, width, focal_px, near, far = map(float, (*hwf, *row[15:]))
    return LlffPose(
        world_to_camera=rigid(rotation, transformed(-rotation, centre)),
        hwf=(height, width, focal_px),
        near=near,
        far=far,
    )


def _to_row(pose: LlffPose) -> Array:
    right, down, forwards = pose.world_to_camera[:3, :3]
    centre = transformed(-pose.world_to_camera[:3, :3].T, pose.world_to_camera[:3, 3])
    matrix = np.stack([down, right, -forwards, centre, np.asarray(pose.hwf)], axis=1)  # (3, 5)
    return np.concatenate([matrix.ravel(), [pose.near, pose.far]])


PLACES = (
    "CAM.mp4",
    "CAM/images/",
    "frames/CAM/",
    "frames_2/CAM/",
    "frames_4/CAM/",
    "frames_8/CAM/",
    "images/CAM/",
    "CAM/",
)
BACKGROUND = "background"
# one picture per camera, as LLFF has them
STILLS = ("images/CAM.png", "images_4/CAM.png", "images_8/CAM.png")
ARRANGEMENTS = (
    "camXX.mp4, camXX/images/, frames/camXX/, frames_N/camXX/, images/XX/ or, of "
    "stills, images/NAME.jpg"
)


def refuse_dynerf(path: Path) -> str | None:
    """Return the reason why this folder is not a DyNeRF capture, or None if it is one."""
    if not (path / POSES).is_file():
        return f"no {POSES}"
    if _find_sources(path):
        return None
    unread = unread_videos(path)
    return f"{POSES}, but no frames ({unread or ARRANGEMENTS})"


def load_dynerf(path: Path, units: GivenUnits, layout: str = "dynerf") -> Capture:
    """Open a DyNeRF capture with any number of cameras, with its backgrounds where it has them
    (D3DMV).

    Reading:
        Row i belongs to the i-th camera in the order of names, never to the number in a name
        (numbers may be missing). One focal length, principal point in the image centre, both scaled
        from the size in the file to the size of the frames. Pictures in ``images/`` alone are
        LLFF's: one instant, one camera each.
    """
    sources = _find_sources(path)
    cameras = posed_cameras(path / POSES, list(sources))
    stills = all(
        isinstance(source, ImageFrames) and source.path.is_file() for source in sources.values()
    )
    if stills and (marked := find_marked(path)):
        raise CaptureError(f"{path}: {marked[0].relative_to(path)} is {marked[1]}; {marked[2]}")
    notes = (
        [f"the pictures beside {POSES} are taken as one instant of {len(sources)} cameras"]
        if stills
        else []
    )
    extras = []
    if layout == "d3dmv" and (path / BACKGROUND).is_dir():
        pictures = backgrounds(path / BACKGROUND, sources)
        extras = [Extras(background=pictures[name]) for name in sources]
    frames = list(sources.values())
    return assemble_capture(
        path,
        layout,
        cameras,
        frames,
        choose_units(path, units, cameras),
        extras=extras,
        notes=notes,
    )


def _find_sources(path: Path) -> dict[str, SizedSource]:
    """Return the frames of each camera in the order of names, by the first arrangement that is
    there.
    """
    return {**(members(path, PLACES, CAMERA_NAME) or members(path, STILLS, ".*"))}


def posed_cameras(file: Path, names: Sequence[str]) -> list[Camera]:
    """Return the cameras of a pose file, whose rows are in the order of these names.

    Raises:
        CaptureError: numbers in names without leading zeros, which have no safe order, or another
            number of rows.
    """
    check_rig_size(file, len(names))
    lengths = {len(name): name for name in names if re.fullmatch(CAMERA_NAME, name)}
    if len(lengths) > 1:
        mismatch = f"{lengths[min(lengths)]} and {lengths[max(lengths)]}"
        raise CaptureError(
            f"{file}: wanted camera numbers of one length, got {mismatch}; add leading zeros, in "
            "the order of rows (loaders of LLFF and Neural 3D Video sort names as text, cam10 "
            "before cam9)"
        )
    poses = read_llff_poses(file)
    if len(poses) != len(names):
        remedy = f"restore the missing {'cameras' if len(poses) > len(names) else 'rows'}"
        raise CaptureError(
            f"{file}: wanted one row for each of the {len(names)} cameras on disk "
            f"({listed(names)}), got {len(poses)} rows; {unread_videos(file.parent) or remedy}"
        )
    return [llff_camera(pose, name, file) for pose, name in zip(poses, names, strict=True)]


@dataclass(frozen=True)
class CameraPath:
    """Poses along a path and what a camera would have seen there.

    Attributes:
        cameras: one pose per image, called ``path0000``, ...
        images: the true images; None if only the poses are known.
        time_s: the instant of the capture that they show, as ``demo.json`` says; the first where it
            says nothing.
    """

    cameras: tuple[Camera, ...]
    images: ImageFrames | None
    time_s: float


def open_path(capture_folder: Path) -> CameraPath | None:
    """Open ``path/poses_bounds.npy`` and ``path/images/`` of a capture folder.

    None if it carries no path.
    """
    poses_file = capture_folder / "path" / POSES
    if not poses_file.is_file():
        return None
    poses = read_llff_poses(poses_file)
    cameras = tuple(
        llff_camera(pose, f"path{index:04d}", poses_file) for index, pose in enumerate(poses)
    )
    time_s = read_note(capture_folder, "path_time_s") or 0.0
    folder = capture_folder / "path" / "images"
    if not folder.is_dir():
        return CameraPath(cameras, None, time_s)
    images = ImageFrames(folder)
    if images.n_frames != len(cameras):
        raise CaptureError(
            f"{folder}: wanted {len(cameras)} images, one per row of {poses_file.name}, got "
            f"{images.n_frames}"
        )
    return CameraPath(tuple(camera.resized(*images.size) for camera in cameras), images, time_s)


DYNERF_LAYOUT = DatasetSpec(
    describe=f"poses_bounds.npy with {ARRANGEMENTS}",
    refuse=refuse_dynerf,
    load=load_dynerf,
    marks=(POSES,),
)


def refuse_meetroom(path: Path) -> str | None:
    """Return the reason why this folder is no MeetRoom capture, or None if it is one."""
    sources, poses_file = _numbered(path)
    if not sources:
        return f"neither cam_<N>.mp4 nor 0000/images/cam00.png with {POSES}"
    return None if poses_file.is_file() else f"cam_<N>.mp4, but no {POSES}"


def load_meetroom(path: Path, units: GivenUnits) -> Capture:
    """Open a capture in StreamRF's arrangement; its cameras are called cam00, cam01, ...

    By their numbers.

    Args:
        path: folder with ``poses_bounds.npy`` and ``cam_<N>.mp4``; or what StreamRF extracts of
            these, a folder per instant with ``images/camNN.png`` and the same ``poses_bounds.npy``,
            in ``frames/`` or in the folder itself.

    Reading:
        Row i belongs to the i-th camera in the order of numbers: StreamRF writes cam_2 as cam02
        before it sorts. One focal length and a central principal point, as LLFF has it; the poses
        of the first instant count, which StreamRF copies to the others.
    """
    sources, poses_file = _numbered(path)
    numbers = sorted(sources)
    cameras = posed_cameras(poses_file, [f"cam{number:02d}" for number in numbers])
    frames = [sources[number] for number in numbers]
    return assemble_capture(path, "meetroom", cameras, frames, choose_units(path, units, cameras))


def _numbered(path: Path) -> tuple[dict[int, CameraFrames], Path]:
    """Return camera number -> its frames, and the pose file: beside the videos, or in the folder of
    the first instant.
    """
    videos = members(path, ["CAM.mp4"], r"cam_\d{1,4}")
    if videos:
        return {
            int(name.removeprefix("cam_")): video for name, video in videos.items()
        }, path / POSES
    for place in FRAMES:
        poses = min((path / place).glob(f"[0-9]*/{POSES}"), default=None)
        pictures = members(path, [f"{place}*/images/CAM.png"], r"cam\d{1,4}")
        if poses and pictures:
            return {
                int(name.removeprefix("cam")): frames for name, frames in pictures.items()
            }, poses
    return {}, path / POSES


MEETROOM_LAYOUT = DatasetSpec(
    "poses_bounds.npy with cam_N.mp4 or 0000/images/camNN.png", refuse_meetroom, load_meetroom
)
