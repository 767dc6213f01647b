"""Captures calibrated by COLMAP: a sparse model, and one image, image folder or video per camera."""

from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.camera_frames import IN_WORDS, listed, require_frames
from ggvs_eval.datasets.colmap_model import CalibratedView, median_depths, model_cameras, read_model, undistorted_sources
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.names import camera_names

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0")


def refuse(path: Path) -> str | None:
    """Return the reason why this is not a COLMAP capture, or None if it is one."""
    return None if find_model(path) else f"no COLMAP model (cameras.bin or cameras.txt) in {', '.join(MODEL_FOLDERS)}"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a capture by its COLMAP model; cameras are called as their images or folders in the model, in the order of names.

    Frames of a distorting camera are undistorted as they are read. Images on disk that the model did not register are noted.

    Raises:
        CaptureError: the model is damaged, or a camera of the model has no frames on disk.
    """
    folder = find_model(path) or path
    views = by_camera(folder, read_model(folder))
    cameras = model_cameras(views, folder)
    frames = require_frames(path, {name: view.image_name for name, view in views.items()})
    chosen = choose_units(path, units, cameras, median_depths=median_depths(views.values()))
    pinhole = undistorted_sources(list(frames.sources.values()), [view.lens for view in views.values()], cameras)
    unregistered = f"{listed(frames.beside)} left out: on disk, but not registered in the COLMAP model"
    return assemble_capture(path, "colmap", cameras, pinhole, chosen, notes=[unregistered] if frames.beside else [])


def find_model(path: Path) -> Path | None:
    """The folder of the first sparse model below a capture."""
    folders = (path / folder for folder in MODEL_FOLDERS)
    return next((folder for folder in folders if any((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))), None)


def by_camera(folder: Path, views: Sequence[CalibratedView]) -> dict[str, CalibratedView]:
    """The views of a model by the names of their cameras, see `camera_names`."""
    names = camera_names([view.image_name for view in views])
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        repeats = f"several images of {listed(twice)}"
        raise CaptureError(f"{folder}: wanted one registered image per fixed camera, got {repeats}; calibrate with one instant")
    return dict(sorted(zip(names, views, strict=True)))


LAYOUT = DatasetSpec(f"sparse/0 with {IN_WORDS}", refuse, load, ("sparse", "colmap"))
