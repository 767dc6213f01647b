"""Cameras of a fixed rig from one instant of its frames: SIFT, exhaustive matching and COLMAP's
mapper, one pose per camera.

The frames are handed to COLMAP in a child process and put next to its model.
"""

import importlib.metadata
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any, Literal

from ggvs_eval.camera import Camera
from ggvs_eval.capture import FrameSource
from ggvs_eval.datasets.calibration_file import find_calibration_files
from ggvs_eval.datasets.camera_frames import CameraFrames, find_rig_frames
from ggvs_eval.datasets.colmap_model import read_model, rig_of_views
from ggvs_eval.datasets.frames import ImageFrames, as_calibrated
from ggvs_eval.datasets.instants import align_instants
from ggvs_eval.datasets.rig import pinhole_cameras
from ggvs_eval.datasets.units import UNITS_FILE
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.atomic import atomic_folder
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.pipelines.offline.calibration.known_cameras import (
    KnownCamera,
    colmap_camera,
    fit_known,
    read_known,
)
from ggvs_eval.progress import track
from ggvs_eval.run_folder import write_json

LOG = "calibration.log"
WORKER = "ggvs_eval.pipelines.offline.calibration.calibration_worker"
# Lines of COLMAP's log that represent one more image whose features, or whose pose, have been
# found.
PROGRESS = re.compile(r"Processed file \[|Registering image #")
CameraModel = Literal["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "OPENCV"]
RECORD = "calibration.json"
MOST_THREADS = 8  # SIFT takes up to 1 GiB per thread at 3200 pixels
MOST_CAMERAS = 60  # pairs grow with the square


@dataclass(frozen=True)
class CalibrationOptions:
    """Options of a calibration.

    Attributes:
        frame: instant to calibrate from, from 0.
        camera_model: lens model; SIMPLE_RADIAL and OPENCV for raw frames, which are then
            undistorted on reading.
        shared_intrinsics: one lens for all cameras of one size; more accurate for equal cameras and
            settings.
        own_lens: cameras that do not share the lens (another zoom).
        known_intrinsics: file or capture with fixed lenses: TOML, COLMAP, Qualisys, anipose,
            freemocap or OpenCV.
        known_poses: one of these with poses; lenses and poses stay fixed, points are triangulated.
        refine: adjust approximate known poses, focal lengths and principal points; scale and
            distortion stay.
        allow_missing: continue without cameras that cannot be registered.
        max_features: maximum number of SIFT features per image.
        max_image_size_px: maximum image side for features, pixels; larger images are reduced.
        seed: seed of random choices.
    """

    frame: int = 0
    camera_model: CameraModel = "PINHOLE"
    shared_intrinsics: bool = False
    own_lens: tuple[str, ...] = ()
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
            raise CaptureError(
                f"calibrate: wanted known intrinsics or known poses (which include intrinsics), "
                f"got {choice}; give one"
            )
        if self.own_lens and not self.shared_intrinsics:
            raise CaptureError(
                "calibrate: wanted shared intrinsics with --own-lens, got none; add "
                "--shared-intrinsics or drop it"
            )
        if self.refine and self.known_poses is None:
            raise CaptureError(
                "calibrate: wanted poses to refine, got none; give them with --known-poses RIG"
            )
        if (
            self.frame < 0
            or self.max_features < 1
            or self.max_image_size_px < 1
            or not 0 <= self.seed < 1 << 31
        ):
            choice = f"{self.frame}, {self.max_features}, {self.max_image_size_px}, {self.seed}"
            raise CaptureError(
                f"calibrate: frame, features, image size and seed must not be negative (or zero), "
                f"got {choice}"
            )


@dataclass(frozen=True)
class OddLens:
    """A camera that would like another focal length than the one that all share.

    Attributes:
        factor: on the common focal length.
        half_width: of the interval of it.
        common_factor: by which the focal length of the others would change.
    """

    factor: float
    half_width: float
    common_factor: float

    def describe(self) -> str:
        """Return the factor with its interval, and what it does to the others."""
        changed = f"; the others then x {self.common_factor:.3f}"
        return (
            f"alone fits x {self.factor:.3f} +- {self.half_width:.3f} of the common focal "
            f"length{changed}"
        )


def own_lens_option(odd: Iterable[str]) -> str:
    """Return the option of `calibrate` that frees some cameras."""
    return f"--own-lens {' '.join(odd)}"


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    Attributes:
        cameras: registered cameras by name, pinhole, in the world of the model.
        missing: cameras that could not be registered, with the reason of each.
        mean_reprojection_error_px: over all observations of all points.
        points_seen: how many of them each camera sees. With known poses, a camera that sees a small
            part of what the others see has a wrong pose or another camera's frames.
        odd_lenses: cameras that disagree with the lens that all share, where one was asked for.
    """

    path: Path
    cameras: Mapping[str, Camera]
    missing: Mapping[str, str]
    mean_reprojection_error_px: float
    n_points: int
    points_seen: Mapping[str, int]
    odd_lenses: Mapping[str, OddLens] = field(default_factory=dict)


def calibrate(frames_folder: Path, out: Path, options: CalibrationOptions) -> Calibration:
    """Calibrate a rig and write it as a capture that `open_capture` reads.

    Equal frames, options and versions of pycolmap give equal models on one machine: seeds are
    fixed, images are numbered in the order of names, matching and mapping run in one thread.
    Another CPU may round differently, which moves cameras by far less than the reprojection error.

    Args:
        frames_folder: videos, folders of images or one image per camera; poses in it are not looked
            at.
        out: capture to write, absent or empty: ``sparse/0``, the frames (videos and folders as
            links, single images as copies), ``calibration.json`` and COLMAP's log.

    Raises:
        CaptureError: no frames, known cameras that do not fit them, cameras that cannot be
            registered, or pycolmap fails.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise CaptureError(
            f"{out}: wanted a new or empty folder for the calibration, got one with content; "
            f"choose another"
        )
    files = find_rig_frames(frames_folder)
    if len(files) > MOST_CAMERAS:
        raise CaptureError(
            f"{frames_folder}: wanted up to {MOST_CAMERAS} cameras, got {len(files)}; calibrate "
            f"directly with COLMAP"
        )
    files, known_cameras = _known(files, options)
    aligned = align_instants(frames_folder, files)
    if strange := [name for name in options.own_lens if name not in files]:
        raise CaptureError(
            f"{frames_folder}: wanted cameras for --own-lens, got {', '.join(strange)}; there are "
            f"{', '.join(files)}"
        )
    with atomic_folder(out) as unfinished:
        images = write_instant(
            files, options.frame, unfinished / "work" / "images", aligned.sources
        )
        result = run_worker(unfinished, out, _job(files, images, known_cameras, options))
        missing = _missing(images, result)
        if missing and (not options.allow_missing or len(images) - len(missing) < 2):
            raise _unregistered(
                frames_folder, missing, len(images), keep_log(unfinished, out), options.known_poses
            )
        shutil.move(unfinished / "work" / "sparse", unfinished / "sparse")
        registered = {name: file for name, file in files.items() if name not in missing}
        link_frames(
            registered,
            {name: unfinished / "work" / "images" / images[name] for name in registered},
            unfinished,
        )
        for table in aligned.tables:
            (unfinished / table).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(frames_folder / table, unfinished / table)
        if (
            options.known_poses
            and known_cameras
            and all(camera.is_metric for camera in known_cameras.values())
        ):
            (unfinished / UNITS_FILE).write_text("units_per_metre = 1.0\n", encoding="utf-8")
        calibration = _read(unfinished, out, missing, result)
        write_json(unfinished / RECORD, _record(frames_folder, calibration, result, options))
        shutil.rmtree(unfinished / "work")
    return calibration


def _known(
    files: dict[str, CameraFrames], options: CalibrationOptions
) -> tuple[dict[str, CameraFrames], dict[str, KnownCamera] | None]:
    """Return the frames and known intrinsics, rescaled to one size; None if nothing is known."""
    path = options.known_poses or options.known_intrinsics
    sizes = {name: file.size for name, file in files.items()}
    if path is None:
        odd = next((name for name in sizes if sizes[name] != next(iter(sizes.values()))), None)
        if options.shared_intrinsics and odd is not None:
            first = next(iter(sizes))
            choice = f"{first} {sizes[first]} and {odd} {sizes[odd]}"
            raise CaptureError(
                f"{files[odd].path}: wanted frames of one size for shared intrinsics, got "
                f"{choice}; calibrate each"
            )
        return files, None
    cameras_by_name = read_known(path, sizes)
    for name, camera in cameras_by_name.items():
        if name in files:
            files[name] = as_calibrated(files[name], camera.lens.width, camera.lens.height)
    cameras = fit_known(path, cameras_by_name, {name: file.size for name, file in files.items()})
    without = [name for name in cameras if cameras[name].world_to_camera is None]
    if options.known_poses is not None and without:
        raise CaptureError(
            f"{path}: wanted poses, got only intrinsics of {', '.join(without)}; pass it by "
            f"--known-intrinsics"
        )
    return files, cameras


def _job(
    files: Mapping[str, CameraFrames],
    images: Mapping[str, str],
    known_cameras: Mapping[str, KnownCamera] | None,
    options: CalibrationOptions,
) -> dict[str, Any]:
    path, with_poses = (
        options.known_poses or options.known_intrinsics or Path(),
        options.known_poses is not None,
    )
    described = describe_known(path, known_cameras or {}, with_poses=with_poses)
    groups: dict[tuple[int, int], list[str]] = {}
    for name, file in files.items():
        groups.setdefault(file.size, []).append(name)
    return {
        "groups": [[images[name] for name in names] for names in groups.values()],
        "model": options.camera_model,
        "shared": options.shared_intrinsics,
        "own_lens": [images[name] for name in options.own_lens],
        "seed": options.seed,
        "threads": min(usable_cpus(), MOST_THREADS),
        "max_features": options.max_features,
        "max_image_size_px": options.max_image_size_px,
        "refine": options.refine,
        "known": {images[name]: view for name, view in described.items()} or None,
    }


def _missing(images: Mapping[str, str], result: Mapping[str, Any]) -> dict[str, str]:
    """Return the cameras that were not registered, with what is known about why."""
    return {
        name: f"{result['features'].get(image, 0)} features, {result['matches'].get(image, 0)} "
        f"matches with its best partner"
        for name, image in images.items()
        if image not in result["registered"]
    }


def _unregistered(
    folder: Path, missing: Mapping[str, str], n_cameras: int, log: Path, known_poses: Path | None
) -> CaptureError:
    """Return the error of a model that lacks cameras.

    Leaving them out is offered only where two others remain.
    """
    listed = ", ".join(f"{name} ({reason})" for name, reason in missing.items())
    remedy = (
        "give these cameras more texture, light or overlap with others, another frame, or "
        "known intrinsics"
    )
    remedy += "" if n_cameras - len(missing) < 2 else ", or continue without them (--allow-missing)"
    if known_poses is not None and find_calibration_files(known_poses):
        remedy += f", or put {known_poses.name} next to the frames, which makes them a capture"
    return CaptureError(
        f"{folder}: wanted a pose of all {n_cameras} cameras, found none of {listed}; {remedy}; "
        f"log: {log}"
    )


def _read(
    unfinished: Path, out: Path, missing: Mapping[str, str], result: Mapping[str, Any]
) -> Calibration:
    views = {Path(view.image_name).stem: view for view in read_model(unfinished / "sparse" / "0")}
    cameras = {camera.name: camera for camera in pinhole_cameras(rig_of_views(views), out)}
    counts = {Path(image).stem: count for image, count in result["registered"].items()}
    odd = {Path(image).stem: OddLens(**values) for image, values in result["odd_lenses"].items()}
    return Calibration(
        path=out,
        cameras=cameras,
        missing=missing,
        mean_reprojection_error_px=result["mean_reprojection_error_px"],
        n_points=result["n_points"],
        points_seen=counts,
        odd_lenses=odd,
    )


def _record(
    folder: Path, calibration: Calibration, result: Mapping[str, Any], options: CalibrationOptions
) -> dict[str, Any]:
    values = {
        key: str(value) if isinstance(value, Path) else value
        for key, value in asdict(options).items()
    }
    return {
        "frames": str(folder.resolve()),
        "options": values,
        "registered": list(calibration.cameras),
        "points_seen": dict(calibration.points_seen),
        "missing": dict(calibration.missing),
        "mean_reprojection_error_px": calibration.mean_reprojection_error_px,
        "n_points": calibration.n_points,
        "odd_lenses": {name: asdict(lens) for name, lens in calibration.odd_lenses.items()},
        "features": result["features"],
        "matches_with_best_partner": result["matches"],
        "attempt": result["attempt"],
        "versions": {"ggvs-eval": importlib.metadata.version("ggvs-eval"), **result["versions"]},
    }


def write_instant(
    files: Mapping[str, CameraFrames],
    frame: int,
    folder: Path,
    sources: Mapping[str, FrameSource] | None = None,
) -> dict[str, str]:
    """Write one image per camera.

    Args:
        frame: the instant, from 0.
        folder: where to; made.
        sources: the frames of the instants that all cameras have; those of the files when None.

    Returns:
        Camera -> name of its image: the camera's name, with the suffix of its file where that is a
        single upright image, which is copied. Others are written as they are read: COLMAP does not
        heed the EXIF tag that turns them.
    """
    images = {}
    folder.mkdir(parents=True)
    for name, file in files.items():
        source = (sources or files)[name]
        if frame >= source.n_frames:
            raise CaptureError(
                f"{file.path}: wanted frame {frame}, it has {source.n_frames}; choose an earlier "
                f"frame"
            )
        image = next(source.frames(frame, frame + 1))
        is_copied = isinstance(file, ImageFrames) and file.path.is_file() and not file.orientations
        images[name] = f"{name}{file.path.suffix if is_copied else '.png'}"
        if images[name].lower().endswith(".png"):
            write_image(folder / images[name], image)
        else:
            shutil.copyfile(file.path, folder / images[name])
    return images


def link_frames(
    files: Mapping[str, CameraFrames], stills: Mapping[str, Path], folder: Path
) -> None:
    """Put frames where the COLMAP adapter looks for them: links to videos and folders, single
    images themselves.

    Args:
        stills: the image of each camera, which is moved where it is all there is of that camera.
    """
    for name, file in files.items():
        if isinstance(file, VideoFrames):
            (folder / f"{name}.mp4").symlink_to(file.path.resolve())
            continue
        (folder / "images").mkdir(exist_ok=True)
        if file.path.is_dir():
            (folder / "images" / name).symlink_to(file.path.resolve())
        else:
            shutil.move(stills[name], folder / "images" / stills[name].name)


def run_worker(unfinished: Path, out: Path, job: Mapping[str, Any]) -> dict[str, Any]:
    """Calibrate in a child process, whose output becomes the log.

    Args:
        unfinished: folder in the making; its ``work/images/`` holds the images, its
            ``work/sparse/0`` will hold the model.
        out: what it will be called, for errors; the log of a failure is kept next to it.
    """
    work = unfinished / "work"
    write_json(work / "job.json", job)
    command = [sys.executable, "-m", WORKER, str(work)]
    pipe = subprocess.PIPE
    with (
        (unfinished / LOG).open("w", encoding="utf-8") as log,
        subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, text=True, errors="replace"
        ) as child,
    ):
        try:
            steps = 2 * sum(map(len, job["groups"]))
            for _ in track(_steps(child.stdout or (), log, steps), "calibrating", steps):
                pass
            child.wait()
        finally:
            child.kill()
    result = work / "result.json"
    if child.returncode or not result.is_file():
        log_copy = keep_log(unfinished, out)
        reason = (
            f"was ended by signal {-child.returncode}"
            if child.returncode < 0
            else f"said '{_last_line(log_copy)}'"
        )
        raise CaptureError(
            f"{out}: wanted a calibration, the pycolmap process {reason}; see its log {log_copy}"
        )
    return dict(json.loads(result.read_text(encoding="utf-8")))


def keep_log(unfinished: Path, out: Path) -> Path:
    """Copy the log of a calibration that failed to where it outlives the folder in the making."""
    log_copy = out.with_name(f"{out.name}.log")
    shutil.copyfile(unfinished / LOG, log_copy)
    return log_copy


def describe_known(
    path: Path, known_cameras: Mapping[str, KnownCamera], *, with_poses: bool
) -> dict[str, dict[str, Any]]:
    """Return the known cameras as the worker reads them, by name."""
    described = {}
    for name, camera in known_cameras.items():
        try:
            model, params = colmap_camera(camera.lens)
        except CameraError as error:
            raise CaptureError(f"{path}: {name}: {error}") from error
        pose = (
            camera.world_to_camera[:3].tolist()
            if with_poses and camera.world_to_camera is not None
            else None
        )
        size = {"width": camera.lens.width, "height": camera.lens.height}
        described[name] = size | {"model": model, "params": params, "world_to_camera": pose}
    return described


def _steps(output: "IO[str] | tuple[str, ...]", log: IO[str], most: int) -> Iterator[None]:
    """Copy the child's output into the log; yields, at most so many times, as it continues."""
    count = 0
    for line in output:
        log.write(line)
        if PROGRESS.search(line) and count < most:
            count += 1
            yield


def _last_line(log: Path) -> str:
    lines = log.read_text(encoding="utf-8").split("\n")
    return next((line.strip()[-200:] for line in reversed(lines) if line.strip()), "nothing")
