"""D3DMV captures (Deep 3D Mask Volume): one HDF5 file per scene with its LLFF poses, or frame folders with backgrounds."""

import re
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, Extras
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.camera_frames import frames_in
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.h5_frames import h5_parts
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.llff import llff_camera, read_llff_poses
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import list_files, list_images

POSES = "poses_bounds.npy"
LISTED = 8


def refuse(path: Path) -> str | None:
    """Return the reason why this file or folder is not a D3DMV capture, or None if it is one."""
    files = _h5_files(path)
    if files:
        posed = any(_pose_file(file).is_file() for file in files)
        return None if posed else f"{files[0].name}, but no {_pose_file(files[0]).name}"
    if not path.is_dir() or not (path / POSES).is_file():
        return f"no SCENE.h5, no {POSES}"
    return None if _frame_folders(path) else f"{POSES}, but neither frames/camXX/ with background/ nor camXX/*.jpg"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a D3DMV scene.

    Args:
        path: ``SCENE.h5``, a folder that holds exactly one, or the folder of a scene's frames.

    Raises:
        CaptureError: several scenes, poses and cameras that do not match, or a file that is damaged or no such file at all.

    Reading:
        Poses are made for the images before compression; the intrinsics are scaled to the frames' size. The depth range is the
        pose file's, per camera; the authors' own 0.9 x the smallest and 2 x the largest is a choice of their renderer. Every 4th
        frame of the videos was kept at a rate that is nowhere stated; frames play at the rate of image folders.
    """
    files = _h5_files(path)
    if len(files) > 1:
        listed = ", ".join(file.name for file in files[:LISTED]) + (", ..." if len(files) > LISTED else "")
        raise CaptureError(f"{path}: wanted one scene, got {len(files)} ({listed}); name one of these files")
    return _load_compressed(path, files[0], units) if files else _load_folders(path, units)


def _load_compressed(path: Path, file: Path, units: GivenUnits) -> Capture:
    parts = h5_parts(file)
    cameras = _read_cameras(_pose_file(file), [f"cam{index:02d}" for index in range(len(parts["rgb"]))])
    none = [None] * len(cameras)
    backgrounds, masks = parts.get("bg_rgb", none), parts.get("fg_rgb", none)
    extras = [Extras(background, mask) for background, mask in zip(backgrounds, masks, strict=True)]
    chosen = choose_units(file.parent, units, cameras)
    return assemble_capture(path, "d3dmv", cameras, parts["rgb"], chosen, scene=file.stem, extras=extras)


def _load_folders(path: Path, units: GivenUnits) -> Capture:
    folders = _frame_folders(path)
    cameras = _read_cameras(path / POSES, list(folders))
    backgrounds = [_background(path, name) for name in folders] if (path / "background").is_dir() else []
    extras = [Extras(background=background) for background in backgrounds]
    sources = [ImageFrames(folder) for folder in folders.values()]
    return assemble_capture(path, "d3dmv", cameras, sources, choose_units(path, units, cameras), extras=extras)


def _h5_files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if path.suffix.lower() == ".h5" else []
    return list_files(path, (".h5",))


def _pose_file(file: Path) -> Path:
    return file.with_name(f"{file.stem}_pb.npy")


def _frame_folders(path: Path) -> dict[str, Path]:
    """Return the folder of each camera in the order of names. Without backgrounds, frames/camXX is DyNeRF's arrangement."""
    parent = path / "frames" if (path / "background").is_dir() and (path / "frames").is_dir() else path
    return {name: frames.path for name, frames in frames_in(parent, "CAM/") if re.fullmatch(r"cam\d+", name)}


def _background(path: Path, name: str) -> ImageFrames:
    image = next((file for file in list_images(path / "background") if file.stem == name), None)
    if image is None:
        raise CaptureError(f"{path / 'background'}: wanted {name}.png or .jpg, got neither; restore it or remove the folder")
    return ImageFrames(image)


def _read_cameras(file: Path, names: list[str]) -> list[Camera]:
    """Read the poses; row i is the i-th camera."""
    if len({len(name) for name in names}) > 1:
        mismatch = f"{min(names, key=len)} and {max(names, key=len)}"
        raise CaptureError(f"{file.parent}: wanted camera numbers of one length, got {mismatch}; add leading zeros")
    poses = read_llff_poses(file)
    if len(poses) != len(names):
        expected_rows = f"one row for each of the {len(names)} cameras ({names[0]}..{names[-1]})"
        raise CaptureError(f"{file}: wanted {expected_rows}, got {len(poses)} rows; restore what is missing")
    return [llff_camera(pose, name, file) for pose, name in zip(poses, names, strict=True)]


LAYOUT = DatasetSpec("SCENE.h5 with SCENE_pb.npy, or frames/ and background/", refuse, load)
