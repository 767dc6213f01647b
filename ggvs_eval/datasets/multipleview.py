"""The "multipleview" layout of 4D Gaussian Splatting: ``camXX/frame_00001.jpg`` with a COLMAP model in ``sparse_/``."""

import re
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.camera_frames import frames_in, listed
from ggvs_eval.datasets.colmap_model import CalibratedView, median_depths, model_cameras, read_model, undistorted_sources
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CaptureError

MODEL = "sparse_"


def refuse(path: Path) -> str | None:
    """Return the reason why this is not a multipleview capture, or None if it is one."""
    if not any((path / MODEL / f"cameras.{kind}").is_file() for kind in ("bin", "txt")):
        return f"no COLMAP model in {MODEL}/"
    return None if _folders(path) else "no folders camXX/ with images"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a multipleview capture; cameras are called as their folders.

    Args:
        path: folder that holds ``sparse_/`` and ``camXX/``.

    Raises:
        CaptureError: the model is damaged, or folders and images of the model do not match.

    Reading:
        The image of camera ``cam07`` is called ``image7.jpg`` or ``image07.jpg`` in the model: the number counts.
    """
    folders = _numbered(path)
    views = _by_number(path, read_model(path / MODEL))
    missing = sorted(set(views) ^ set(folders))
    if missing:
        gaps = listed([f"cam{number:02d} ({'model' if number in views else 'folder'} only)" for number in missing])
        raise CaptureError(f"{path}: wanted a folder camXX/ per image of {MODEL}/, got {gaps}; restore or remove these")
    numbers = sorted(folders)
    cameras = model_cameras({folders[number].name: views[number] for number in numbers}, path / MODEL)
    sources = [ImageFrames(folders[number]) for number in numbers]
    chosen = choose_units(path, units, cameras, median_depths=median_depths(views.values()))
    pinhole = undistorted_sources(sources, [views[number].lens for number in numbers], cameras)
    return assemble_capture(path, "multipleview", cameras, pinhole, chosen)


def _folders(path: Path) -> list[Path]:
    return [frames.path for name, frames in frames_in(path, "CAM/") if re.fullmatch(r"cam\d{1,6}", name)]


def _numbered(path: Path) -> dict[int, Path]:
    """Camera number -> its folder."""
    numbered: dict[int, Path] = {}
    for folder in _folders(path):
        other = numbered.setdefault(int(folder.name.removeprefix("cam")), folder)
        if other != folder:
            raise CaptureError(f"{path}: wanted one folder per camera, got {other.name} and {folder.name}; keep one of them")
    return numbered


def _by_number(path: Path, views: list[CalibratedView]) -> dict[int, CalibratedView]:
    numbered = {}
    for view in views:
        match = re.fullmatch(r"\D*(\d{1,6})\.\w+", view.image_name)
        if not match or int(match[1]) in numbered:
            raise CaptureError(f"{path / MODEL}: wanted images called image<number>.jpg, one per camera, got {view.image_name!r}")
        numbered[int(match[1])] = view
    return numbered


LAYOUT = DatasetSpec("sparse_/ with camXX/frame_00001.jpg", refuse, load, ("sparse_",))
