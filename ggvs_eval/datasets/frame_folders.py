"""Captures with a folder per instant, ``frame000000/images/cam00.png``, and a COLMAP model in the first: 3DGStream's layout."""

import re
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.camera_frames import listed
from ggvs_eval.datasets.colmap import by_camera, find_model
from ggvs_eval.datasets.colmap_model import median_depths, model_cameras, read_model, undistorted_sources
from ggvs_eval.datasets.frames import NumberedFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import list_images

MARK = "frame[0-9]*"
INSTANT = re.compile(r"frame_?(\d{1,9})")


def refuse(path: Path) -> str | None:
    """Return the reason why this folder is no capture with a folder per instant, or None if it is one."""
    instants = numbered_folders(path, INSTANT)
    if not instants:
        return "no folders frame000000/images/"
    if find_model(path) or find_model(next(iter(instants.values()))):
        return None
    first = next(iter(instants.values())).name
    return f"{first}/, but no COLMAP model in it: 'ggvs-eval calibrate {path / first} RIG' finds one, put its sparse/ there"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a capture; cameras are called as their images in the model, without suffix, in the order of names.

    Reading:
        The model of the first instant counts: the cameras stand still, and 3DGStream copies it to the others.
    """
    instants = numbered_folders(path, INSTANT)
    folder = find_model(next(iter(instants.values()))) or find_model(path) or path
    views = by_camera(folder, read_model(folder))
    pictures = instant_pictures(instants)
    missing = sorted(set(views) - set(pictures))
    if missing:
        raise CaptureError(f"{path}: wanted pictures of {listed(missing)} as {folder} has them, got none; restore them")
    sources = [NumberedFrames(path, tuple(pictures[name])) for name in views]
    cameras = model_cameras(views, folder)
    chosen = choose_units(path, units, cameras, median_depths=median_depths(views.values()))
    pinhole = undistorted_sources(sources, [view.lens for view in views.values()], cameras)
    left = sorted(set(pictures) - set(views))
    notes = [f"{listed(left)} left out: on disk, but not registered in the COLMAP model"] if left else []
    return assemble_capture(path, "3dgstream", cameras, pinhole, chosen, notes=notes)


def numbered_folders(parent: Path, name: re.Pattern[str]) -> dict[int, Path]:
    """Folders of instants with pictures in ``images/``, by their numbers, in the order of time."""
    matches = [(name.fullmatch(each.name), each) for each in sorted(parent.iterdir())] if parent.is_dir() else []
    numbered = {int(match[match.re.groups]): folder for match, folder in matches if match and list_images(folder / "images")}
    return dict(sorted(numbered.items()))


def instant_pictures(instants: dict[int, Path]) -> dict[str, list[tuple[int, Path]]]:
    """Pictures of each camera with the numbers of their instants, by the name of the picture."""
    pictures: dict[str, list[tuple[int, Path]]] = {}
    for number, folder in instants.items():
        for file in list_images(folder / "images"):
            pictures.setdefault(file.stem, []).append((number, file))
    return pictures


LAYOUT = DatasetSpec("frame000000/images/camXX.png with sparse/0 in the first (3DGStream)", refuse, load, (MARK,))
