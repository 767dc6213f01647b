"""Captures calibrated by COLMAP: a sparse model, and one image, image folder or video per camera."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import ARRANGEMENTS, SizedSource, assemble_capture, find_sources, listed
from ggvs_eval.datasets.colmap_model import CalibratedView, median_depths, model_cameras, read_model, undistorted_sources
from ggvs_eval.datasets.frames import ImageFrames, list_images
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import VideoFrames

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0")
__all__ = ["ARRANGEMENTS", "find_model", "load", "refuse"]


def refuse(path: Path) -> str | None:
    """Return the reason why this is not a COLMAP capture, or None if it is one."""
    return None if find_model(path) else f"no COLMAP model (cameras.bin or cameras.txt) in {', '.join(MODEL_FOLDERS)}"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a capture by its COLMAP model; cameras are called as their images in the model, without suffix, in the order of names.

    Frames of a distorting camera are undistorted as they are read. Images on disk that the model did not register are noted.

    Args:
        path: folder that holds the model and the frames.
        units: world units per metre or a file that says how to measure them; see `choose_units`.

    Raises:
        CaptureError: the model is damaged, or a camera of the model has no frames on disk.
    """
    folder = find_model(path) or path
    views = by_camera(folder, read_model(folder))
    cameras = model_cameras(views, folder)
    sources = find_sources(path, {name: view.image_name for name, view in views.items()})
    chosen = choose_units(path, units, cameras, median_depths=median_depths(views.values()))
    pinhole = undistorted_sources(sources, [view.lens for view in views.values()], cameras)
    return assemble_capture(path, "colmap", cameras, pinhole, chosen, notes=_unregistered(sources[0], set(views)))


def find_model(path: Path) -> Path | None:
    """The folder of the first sparse model below a capture."""
    folders = (path / folder for folder in MODEL_FOLDERS)
    return next((folder for folder in folders if any((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))), None)


def by_camera(folder: Path, views: Sequence[CalibratedView]) -> dict[str, CalibratedView]:
    """The views of a model by the names of their cameras.

    Raises:
        CaptureError: several images of one camera.
    """
    names = [_camera_name(view.image_name) for view in views]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        repeats = f"several images of {listed(twice)}"
        raise CaptureError(f"{folder}: wanted one registered image per fixed camera, got {repeats}; calibrate with one instant")
    return dict(zip(names, views, strict=True))


def _camera_name(image_name: str) -> str:
    """``cam00.png`` and ``cam00/0000.png`` are both of camera cam00."""
    name = PurePosixPath(image_name)
    return name.parent.name or name.stem


def _unregistered(source: SizedSource, registered: set[str]) -> list[str]:
    """A note about the frames that lie beside those of the registered cameras and that the model knows nothing of."""
    place = source.path if isinstance(source, VideoFrames | ImageFrames) else Path()
    if isinstance(source, VideoFrames):
        beside = [file.stem for file in place.parent.glob("*.mp4")]
    elif place.is_file():
        beside = [_camera_name(file.name) for file in list_images(place.parent)]
    elif place.name == "images":
        beside = [folder.parent.name for folder in place.parent.parent.glob("*/images") if list_images(folder)]
    else:
        beside = [folder.name for folder in place.parent.iterdir() if list_images(folder)]
    extra = sorted(set(beside) - registered)
    return [f"{listed(extra)} left out: on disk, but not registered in the COLMAP model"] if extra else []
