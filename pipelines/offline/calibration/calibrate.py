"""Cameras of a fixed rig from one instant of its frames: SIFT, exhaustive matching and COLMAP's mapper, one pose per camera."""

import importlib.metadata
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import common_count
from ggvs_eval.datasets.calibration_file import find_calibration_files
from ggvs_eval.datasets.camera_frames import CameraFrames, find_rig_frames
from ggvs_eval.datasets.colmap_model import model_cameras, read_model
from ggvs_eval.datasets.frames import as_calibrated
from ggvs_eval.datasets.units import UNITS_FILE
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.atomic import atomic_folder
from ggvs_eval.geometry.alignment import pose_differences, rig_extent
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.pipelines.offline.calibration.calibration_job import describe_known, keep_log, run_worker
from ggvs_eval.pipelines.offline.calibration.camera_files import link_frames, write_instant
from ggvs_eval.pipelines.offline.calibration.known_cameras import KnownCamera, fit_known, read_known
from ggvs_eval.run_folder import write_json

CameraModel = Literal["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "OPENCV"]
RECORD = "calibration.json"
MOST_THREADS = 8  # SIFT takes up to 1 GiB per thread at 3200 pixels
MOST_CAMERAS = 60  # pairs grow with the square


@dataclass(frozen=True)
class CalibrationOptions:
    """Options of a calibration.

    Attributes:
        frame: the instant, from 0.
        camera_model: of the lenses: PINHOLE and SIMPLE_PINHOLE for undistorted frames, SIMPLE_RADIAL and OPENCV for raw ones,
            which are then undistorted whenever the result is read. Known lenses bring their own.
        shared_intrinsics: one lens for all cameras, which must then have one size; more exact where all are of one make and
            setting (flame_steak: rotations within 0.04 degrees of the given ones, 0.32 with a lens each). Otherwise lenses begin
            as one for all cameras of one size and are then adjusted one by one.
        known_intrinsics: ``intrinsics.toml``, ``capture.toml``, a COLMAP model, a calibration of Qualisys, anipose, freemocap or
            OpenCV, or a capture whose lenses are kept fixed.
        known_poses: any of these that has poses; lenses and poses are kept fixed and points triangulated.
        refine: known poses are nearly right: poses, focal lengths and principal points move to where the features are, camera by
            camera; the world, its scale and the lenses' distortion stay.
        allow_missing: go on without cameras that cannot be registered.
        max_features: SIFT features per image.
        max_image_size_px: larger images are reduced to this for finding features.
        seed: of every random choice.
    """

    frame: int = 0
    camera_model: CameraModel = "PINHOLE"
    shared_intrinsics: bool = False
    known_intrinsics: Path | None = None
    known_poses: Path | None = None
    refine: bool = False
    allow_missing: bool = False
    max_features: int = 4096
    max_image_size_px: int = 3200
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse options that contradict each other."""
        if self.known_intrinsics is not None and self.known_poses is not None:
            choice = f"{self.known_intrinsics} and {self.known_poses}"
            raise CaptureError(f"calibrate: wanted known intrinsics or known poses, which bring theirs, got {choice}; give one")
        if self.refine and self.known_poses is None:
            raise CaptureError("calibrate: wanted poses to refine, got none; give them with --known-poses RIG")
        if self.frame < 0 or self.max_features < 1 or self.max_image_size_px < 1 or not 0 <= self.seed < 1 << 31:
            choice = f"{self.frame}, {self.max_features}, {self.max_image_size_px}, {self.seed}"
            raise CaptureError(f"calibrate: frame, features, image size and seed must not be negative (or zero), got {choice}")


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    Attributes:
        cameras: registered cameras by name, pinhole, in the world of the model.
        missing: cameras that could not be registered, with the reason of each.
        mean_reprojection_error_px: over all observations of all points.
        points_seen: how many of them each camera sees. With known poses, a camera that sees a small part of what the others see
            has a wrong pose or another camera's frames.
    """

    path: Path
    cameras: Mapping[str, Camera]
    missing: Mapping[str, str]
    mean_reprojection_error_px: float
    n_points: int
    points_seen: Mapping[str, int]


def calibrate(frames_folder: Path, out: Path, options: CalibrationOptions) -> Calibration:
    """Calibrate a rig and write it as a capture that `open_capture` reads.

    Equal frames, options and versions of pycolmap give equal models on one machine: seeds are fixed, images are numbered in the
    order of names, matching and mapping run in one thread. Another CPU may round differently, which moves cameras by far less
    than the reprojection error.

    Args:
        frames_folder: videos, folders of images or one image per camera; poses in it are not looked at.
        out: capture to write, absent or empty: ``sparse/0``, the frames (videos and folders as links, single images as copies),
            ``calibration.json`` and COLMAP's log.

    Raises:
        CaptureError: no frames, known cameras that do not fit them, cameras that cannot be registered, or pycolmap fails.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise CaptureError(f"{out}: wanted a new or empty folder for the calibration, got one with content; choose another")
    files = find_rig_frames(frames_folder)
    common_count(frames_folder, files)
    if len(files) > MOST_CAMERAS:
        raise CaptureError(f"{frames_folder}: wanted up to {MOST_CAMERAS} cameras, got {len(files)}; calibrate by COLMAP itself")
    files, given = _known(files, options)
    with atomic_folder(out) as unfinished:
        images = write_instant(files, options.frame, unfinished / "work" / "images")
        result = run_worker(unfinished, out, _job(files, images, given, options))
        missing = _missing(images, result)
        if missing and (not options.allow_missing or len(images) - len(missing) < 2):
            raise _unregistered(frames_folder, missing, len(images), keep_log(unfinished, out), options.known_poses)
        shutil.move(unfinished / "work" / "sparse", unfinished / "sparse")
        registered = {name: file for name, file in files.items() if name not in missing}
        link_frames(registered, {name: unfinished / "work" / "images" / images[name] for name in registered}, unfinished)
        if options.known_poses and given and all(camera.is_metric for camera in given.values()):
            (unfinished / UNITS_FILE).write_text("units_per_metre = 1.0\n", encoding="utf-8")
        calibration = _read(unfinished, out, missing, result)
        write_json(unfinished / RECORD, _record(frames_folder, calibration, result, options))
        shutil.rmtree(unfinished / "work")
    return calibration


def measure_against(given: Capture, calibration: Calibration) -> dict[str, float]:
    """Compare a calibration with the cameras of a capture, after aligning the centres by a similarity.

    Args:
        given: cameras to compare with, matched by name, at any size of the same frames.

    Returns:
        ``n_given``, ``n_registered`` (of these), ``mean_reprojection_error_px``, ``n_points``, ``centre_error_percent_max`` and
        ``_mean`` (of the rig's extent, the largest distance of two given cameras), ``rotation_error_deg_max`` and ``_mean``,
        ``focal_error_percent_max``.
    """
    truth = {camera.name: camera for camera in given.cameras}
    distances, angles_rad = pose_differences(calibration.cameras, truth)
    common = [(camera, truth[name].resized(*camera.size)) for name, camera in calibration.cameras.items() if name in truth]
    centre_percent = 100 * distances / rig_extent(truth)
    focal_percent = [100 * abs(camera.focal_px / true.focal_px - 1) for camera, true in common]
    return {
        "n_given": len(truth),
        "n_registered": len(common),
        "mean_reprojection_error_px": calibration.mean_reprojection_error_px,
        "n_points": calibration.n_points,
        "centre_error_percent_max": float(centre_percent.max()),
        "centre_error_percent_mean": float(centre_percent.mean()),
        "rotation_error_deg_max": float(np.degrees(angles_rad.max())),
        "rotation_error_deg_mean": float(np.degrees(angles_rad.mean())),
        "focal_error_percent_max": max(focal_percent),
    }


def _known(
    files: dict[str, CameraFrames], options: CalibrationOptions
) -> tuple[dict[str, CameraFrames], dict[str, KnownCamera] | None]:
    """The frames as what the user knows of the cameras means them, and that at their size; None where nothing is known."""
    path = options.known_poses or options.known_intrinsics
    sizes = {name: file.size for name, file in files.items()}
    if path is None:
        odd = next((name for name in sizes if sizes[name] != next(iter(sizes.values()))), None)
        if options.shared_intrinsics and odd is not None:
            first = next(iter(sizes))
            choice = f"{first} {sizes[first]} and {odd} {sizes[odd]}"
            raise CaptureError(
                f"{files[odd].path}: wanted frames of one size for shared intrinsics, got {choice}; calibrate each"
            )
        return files, None
    known = read_known(path, sizes)
    for name, camera in known.items():
        if name in files:
            files[name] = as_calibrated(files[name], camera.lens.width, camera.lens.height)
    cameras = fit_known(path, known, {name: file.size for name, file in files.items()})
    without = [name for name in cameras if cameras[name].world_to_camera is None]
    if options.known_poses is not None and without:
        raise CaptureError(f"{path}: wanted poses, got intrinsics alone of {', '.join(without)}; give it as known intrinsics")
    return files, cameras


def _job(
    files: Mapping[str, CameraFrames],
    images: Mapping[str, str],
    given: Mapping[str, KnownCamera] | None,
    options: CalibrationOptions,
) -> dict[str, Any]:
    path, with_poses = options.known_poses or options.known_intrinsics or Path(), options.known_poses is not None
    described = describe_known(path, given or {}, with_poses=with_poses)
    groups: dict[tuple[int, int], list[str]] = {}
    for name, file in files.items():
        groups.setdefault(file.size, []).append(name)
    return {
        "groups": [[images[name] for name in names] for names in groups.values()],
        "model": options.camera_model,
        "shared": options.shared_intrinsics,
        "seed": options.seed,
        "threads": min(default_workers(), MOST_THREADS),
        "max_features": options.max_features,
        "max_image_size_px": options.max_image_size_px,
        "refine": options.refine,
        "known": {images[name]: view for name, view in described.items()} or None,
    }


def _missing(images: Mapping[str, str], result: Mapping[str, Any]) -> dict[str, str]:
    """Cameras that were not registered, with what is known about why."""
    return {
        name: f"{result['features'].get(image, 0)} features, {result['matches'].get(image, 0)} matches with its best partner"
        for name, image in images.items()
        if image not in result["registered"]
    }


def _unregistered(folder: Path, missing: Mapping[str, str], n_cameras: int, log: Path, known_poses: Path | None) -> CaptureError:
    """The error of a model that lacks cameras; leaving them out is offered only where two others remain."""
    listed = ", ".join(f"{name} ({reason})" for name, reason in missing.items())
    mend = "give these cameras more texture, light or overlap with others, another frame, or known intrinsics"
    mend += "" if n_cameras - len(missing) < 2 else ", or go on without them (--allow-missing)"
    if known_poses is not None and find_calibration_files(known_poses):
        mend += f", or put {known_poses.name} beside the frames, which makes a capture of them as it stands"
    return CaptureError(f"{folder}: wanted a pose of all {n_cameras} cameras, found none of {listed}; {mend}; log: {log}")


def _read(unfinished: Path, out: Path, missing: Mapping[str, str], result: Mapping[str, Any]) -> Calibration:
    views = {Path(view.image_name).stem: view for view in read_model(unfinished / "sparse" / "0")}
    cameras = {camera.name: camera for camera in model_cameras(views, out)}
    counts = {Path(image).stem: count for image, count in result["registered"].items()}
    return Calibration(out, cameras, missing, result["mean_reprojection_error_px"], result["n_points"], counts)


def _record(folder: Path, calibration: Calibration, result: Mapping[str, Any], options: CalibrationOptions) -> dict[str, Any]:
    chosen = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(options).items()}
    return {
        "frames": str(folder.resolve()),
        "options": chosen,
        "registered": list(calibration.cameras),
        "points_seen": dict(calibration.points_seen),
        "missing": dict(calibration.missing),
        "mean_reprojection_error_px": calibration.mean_reprojection_error_px,
        "n_points": calibration.n_points,
        "features": result["features"],
        "matches_with_best_partner": result["matches"],
        "attempt": result["attempt"],
        "versions": {"ggvs-eval": importlib.metadata.version("ggvs-eval"), **result["versions"]},
    }
