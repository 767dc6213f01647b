"""D3DMV captures (Deep 3D Mask Volume): one HDF5 file per scene with its LLFF poses, or frame
folders with backgrounds.
"""

from pathlib import Path

from ggvs_eval.capture import Capture, Extras
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.h5_frames import h5_parts
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.llff import BACKGROUND, load_dynerf, posed_cameras
from ggvs_eval.datasets.media import members
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import list_files
from ggvs_eval.files.names import listed

POSES = "poses_bounds.npy"


def refuse(path: Path) -> str | None:
    """Return the reason why this file or folder is not a D3DMV capture, or None if it is one."""
    files = _h5_files(path)
    if files:
        posed = any(_pose_file(file).is_file() for file in files)
        return None if posed else f"{files[0].name}, but no {_pose_file(files[0]).name}"
    if not path.is_dir() or not (path / POSES).is_file():
        return f"no SCENE.h5, no {POSES}"
    parents = ("", "frames/") if (path / BACKGROUND).is_dir() else ("",)
    is_filmed = members(path, [f"{parent}CAM/" for parent in parents], r"cam\d+")
    return (
        None
        if is_filmed
        else f"{POSES}, but neither frames/camXX/ with {BACKGROUND}/ nor camXX/*.jpg"
    )


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a D3DMV scene.

    Args:
        path: ``SCENE.h5``, a folder that holds exactly one, or the folder of a scene's frames.

    Raises:
        CaptureError: several scenes, poses and cameras that do not match, or a file that is damaged
            or no such file at all.

    Reading:
        Poses are made for the images before compression; the intrinsics are scaled to the frames'
        size. The depth range is the pose file's, per camera; the authors' own 0.9 x the smallest
        and 2 x the largest is a choice of their renderer. Every 4th frame of the videos was kept at
        a rate that is nowhere stated; frames play at the rate of image folders.
    """
    files = _h5_files(path)
    if len(files) > 1:
        names = listed(file.name for file in files)
        raise CaptureError(
            f"{path}: wanted one scene, got {len(files)} ({names}); name one of these files"
        )
    return _load_compressed(path, files[0], units) if files else load_dynerf(path, units, "d3dmv")


def _load_compressed(path: Path, file: Path, units: GivenUnits) -> Capture:
    parts = h5_parts(file)
    cameras = posed_cameras(
        _pose_file(file), [f"cam{index:02d}" for index in range(len(parts["rgb"]))]
    )
    none = [None] * len(cameras)
    backgrounds, masks = parts.get("bg_rgb", none), parts.get("fg_rgb", none)
    extras = [Extras(background, mask) for background, mask in zip(backgrounds, masks, strict=True)]
    scale = choose_units(file.parent, units, cameras)
    return assemble_capture(
        path, "d3dmv", cameras, parts["rgb"], scale, scene=file.stem, extras=extras
    )


def _h5_files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if path.suffix.lower() == ".h5" else []
    return list_files(path, (".h5",))


def _pose_file(file: Path) -> Path:
    return file.with_name(f"{file.stem}_pb.npy")


LAYOUT = DatasetSpec("SCENE.h5 with SCENE_pb.npy, or frames/ and background/", refuse, load)
