"""EasyMocap captures, as ENeRF-Outdoor is distributed: ``intri.yml``, ``extri.yml`` and
``images/XX/``.

The two camera files are OpenCV's YAML with one entry per camera and quantity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import rigid
from ggvs_eval.capture import Capture, Extras
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size, given_crop
from ggvs_eval.datasets.calibration_readers import FileCamera
from ggvs_eval.datasets.camera_frames import CameraFrames, backgrounds, find_frames
from ggvs_eval.datasets.depth_range import points_depth_range, read_points, rig_depth_range
from ggvs_eval.datasets.filestorage_yaml import FileStorageYaml, refused
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.media import members
from ggvs_eval.datasets.rig import RigCamera, pinhole_rig, undistorted
from ggvs_eval.datasets.units import METRIC, GivenUnits, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.array_file import read_numbers
from ggvs_eval.files.listing import list_files, list_images
from ggvs_eval.files.names import listed
from ggvs_eval.lens import PIXEL_CENTRE, Lens

INTRINSICS, EXTRINSICS = "intri.yml", "extri.yml"
MASK_FOLDERS = ("mask", "masks", "bgmtv2", "schp")
BACKGROUND_FOLDERS = ("bkgd", "background")
HULLS, BACKGROUND_POINTS = "vhull", "background.ply"
# ENeRF-Outdoor is played back at this rate; other captures in this layout say nothing.
OUTDOOR_FPS = 60.0
# People move beyond the hulls of the frames that are there, and surfaces end beyond their points.
MARGIN = 0.1


def read_views(intrinsics: Path, extrinsics: Path) -> tuple[list[FileCamera], list[str]]:
    """Read both files.

    Args:
        intrinsics: ``intri.yml`` with ``names``, ``K_<cam>``, ``dist_<cam>`` or ``D_<cam>``, maybe
            ``H_``, ``W_``.
        extrinsics: ``extri.yml`` with ``R_<cam>`` (Rodrigues) or ``Rot_<cam>`` (matrix),
            ``T_<cam>``, maybe ``n_``, ``f_``.

    Returns:
        The cameras in the order of ``names``, and the names of those that the second file does not
        place.

    Raises:
        CaptureError: absent or damaged, or an entry that is absent, of another shape or not finite.

    Reading:
        Where both are there, R_ counts, as ENeRF reads it. The camera centre is -R^T T. OpenCV's
        principal point is moved by half a pixel to this package's pixel centres.
    """
    extri = FileStorageYaml(extrinsics)
    lenses = read_lenses(intrinsics)
    placed = [
        name for name in lenses if any(extri.has(f"{key}_{name}") for key in ("R", "Rot", "T"))
    ]
    views = []
    for name in placed:
        near, far = extri.number(f"n_{name}"), extri.number(f"f_{name}")
        near_far = (near, far) if near and far else None
        views.append(replace(lenses[name], world_to_camera=_pose(extri, name), near_far=near_far))
    return views, [name for name in lenses if name not in placed]


def read_lenses(path: Path) -> dict[str, FileCamera]:
    """Read ``intri.yml``, the first file of `read_views`.

    Gives the cameras by name, without poses.
    """
    file = FileStorageYaml(path)
    names = file.texts("names")
    if not all(names) or not names or len(set(names)) < len(names):
        raise refused(
            path, "names: a sequence of different camera names", ", ".join(names) or "none"
        )
    check_rig_size(path, len(names))
    cameras = {}
    for name in names:
        K = file.matrix(f"K_{name}", (3, 3))
        K[:2, 2] += PIXEL_CENTRE
        key = next((key for key in (f"dist_{name}", f"D_{name}") if file.has(key)), None)
        coefficients = tuple(map(float, file.matrix(key, None).ravel())) if key else (0.0,) * 5
        width, height = file.number(f"W_{name}"), file.number(f"H_{name}")
        size = (round(width), round(height)) if width and height else None
        cameras[name] = FileCamera(
            name=name,
            K=K,
            model="opencv",
            coefficients=coefficients,
            size=size,
            world_to_camera=None,
        )
    return cameras


def _pose(extri: FileStorageYaml, name: str) -> Array:
    # what is not used must make sense too
    if not extri.has(f"R_{name}") or extri.has(f"Rot_{name}"):
        rotation = extri.matrix(f"Rot_{name}", (3, 3))
    if extri.has(f"R_{name}"):
        rotation = cv2.Rodrigues(extri.matrix(f"R_{name}", (3, 1)))[0]
    return rigid(rotation, extri.matrix(f"T_{name}", (3, 1)).ravel())


def refuse(path: Path) -> str | None:
    """Return the reason why this is not an EasyMocap capture, or None if it is one."""
    missing = [name for name in (INTRINSICS, EXTRINSICS) if not (path / name).is_file()]
    if missing:
        return f"no {' and '.join(missing)}"
    is_filmed = members(path, ("images/CAM/", "videos/CAM.mp4"), ".*")
    return None if is_filmed else "no folders images/XX/ and no videos/XX.mp4"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open an EasyMocap capture; frames and backgrounds are undistorted as they are read.

    Reading:
        Cameras without a pose or frames are left out and noted: lenses are often calibrated for
        more than were placed. The pinhole image keeps the lens's K, as ENeRF undistorts; pixels the
        lens did not see are black. A sequence with visual hulls is ENeRF-Outdoor: metric, 60 frames
        per second. Depth range: see `_depth_ranges`.
    """
    views, frames, notes = _filmed(path)
    sources = [frames[view.name] for view in views]
    lenses = []
    for view, source in zip(views, sources, strict=True):
        try:
            lenses.append(view.lens(source.size, given_crop(path)))
        except CameraError as error:
            raise CaptureError(
                f"{path / INTRINSICS}: {view.name}: {error} (as W_{view.name} and H_{view.name})"
            ) from error
    is_outdoor = (path / HULLS).is_dir()
    poses = [view.world_to_camera for view in views if view.world_to_camera is not None]
    depths = _depth_ranges(path, [view.near_far for view in views], poses, lenses)
    names = [view.name for view in views]
    rig = [
        RigCamera(*values, values[1].K) for values in zip(names, lenses, poses, depths, strict=True)
    ]
    extras = _extras(path, dict(zip(names, lenses, strict=True)), sources[0].n_frames)
    cameras, pinhole = pinhole_rig(rig, sources, path / EXTRINSICS, path)
    scale = choose_units(path, units, cameras, of_data_set=METRIC if is_outdoor else None)
    fps = OUTDOOR_FPS if is_outdoor else None
    return assemble_capture(
        path, "enerf-outdoor", cameras, pinhole, scale, fps=fps, extras=extras, notes=notes
    )


def _filmed(path: Path) -> tuple[list[FileCamera], dict[str, CameraFrames], list[str]]:
    """Return the cameras with a pose and frames, their frames, and notes on those that are left
    out.
    """
    placed, unplaced = read_views(path / INTRINSICS, path / EXTRINSICS)
    frames, beside, notes = find_frames(path, {view.name: f"{view.name}.png" for view in placed})
    strange = sorted(set(beside) - set(unplaced))
    notes += [f"{listed(unplaced)} left out: not placed in {EXTRINSICS}"] if unplaced else []
    notes += [f"{listed(strange)} left out: not in {INTRINSICS}"] if strange else []
    if len(frames) < 2:
        raise CaptureError(
            f"{path}: wanted two or more cameras with a pose, got {listed(frames)} "
            f"({'; '.join(notes)})"
        )
    return [view for view in placed if view.name in frames], frames, notes


def _depth_ranges(
    path: Path,
    near_fars: Sequence[tuple[float, float] | None],
    poses: Sequence[Array],
    lenses: Sequence[Lens],
) -> list[tuple[float, float] | None]:
    """Near and far of each camera; None if the capture says nothing of them.

    Reading:
        What extri.yml says (n_, f_) where it does; else the nearest corner of the people's hulls,
        with a margin, to the far end of background.ply as each camera sees it, or of
        `rig_depth_range` without that file.
    """
    corners = _hull_corners(path)
    background = (
        read_points(path / BACKGROUND_POINTS)
        if (path / BACKGROUND_POINTS).is_file()
        else np.empty((0, 3))
    )
    guesses = rig_depth_range(poses)
    ranges: list[tuple[float, float] | None] = []
    for near_far, pose, lens, (_, guessed_far) in zip(
        near_fars, poses, lenses, guesses, strict=True
    ):
        depths = corners @ pose[2, :3] + pose[2, 3]
        surfaces = points_depth_range(background, pose, lens.K, (lens.width, lens.height))
        is_in_front = bool(corners.size and depths.min() > 0)
        if near_far is not None or not (is_in_front or surfaces):
            ranges.append(near_far)
            continue
        near = depths.min() if is_in_front or surfaces is None else surfaces[0]
        far = max(surfaces[2] if surfaces else guessed_far / (1 + MARGIN), depths.max(initial=0.0))
        ranges.append((float(near * (1 - MARGIN)), float(far * (1 + MARGIN))))
    return ranges


def _hull_corners(path: Path) -> Array:
    """Return the corners of the hulls' bounds in all frames, (N, 3), world."""
    corners = []
    for file in list_files(path / HULLS, (".npy",)):
        bounds = read_numbers(file, (2, 3), "(2, 3) finite numbers, the least and greatest corner")
        if not np.isfinite(bounds).all():
            raise CaptureError(f"{file}: wanted finite numbers, got NaN or infinity; restore it")
        corners.append(
            [
                [bounds[i, 0], bounds[j, 1], bounds[k, 2]]
                for i in (0, 1)
                for j in (0, 1)
                for k in (0, 1)
            ]
        )
    return np.array(corners, dtype=np.float64).reshape(-1, 3)


def _extras(path: Path, lenses: Mapping[str, Lens], n_frames: int) -> list[Extras]:
    """Backgrounds and masks, where the sequence has them.

    Backgrounds must be there for all cameras or none.
    """
    pictures: Mapping[str, ImageFrames] = {}
    if place := next(
        (path / name for name in BACKGROUND_FOLDERS if list_images(path / name)), None
    ):
        pictures = backgrounds(place, lenses)
    folder = next((path / name for name in MASK_FOLDERS if (path / name).is_dir()), None)
    extras = []
    for name, lens in lenses.items():
        has_mask = folder is not None and bool(list_images(folder / name))
        mask = (
            undistorted(ImageFrames(folder / name), lens, lens.K) if folder and has_mask else None
        )
        if mask is not None and mask.n_frames != n_frames:
            counts = f"{mask.n_frames} for {n_frames} frames"
            raise CaptureError(
                f"{folder}: wanted one mask of {name} per frame, got {counts}; restore them, or "
                f"move the folder elsewhere"
            )
        extras.append(
            Extras(
                background=undistorted(pictures[name], lens, lens.K) if pictures else None,
                mask=mask,
            )
        )
    return extras


LAYOUT = DatasetSpec(
    describe="intri.yml and extri.yml with images/XX/ or videos/XX.mp4 (EasyMocap)",
    refuse=refuse,
    load=load,
    marks=(INTRINSICS, EXTRINSICS),
)
