"""Captures calibrated by COLMAP: a sparse model and one image, image folder or video per camera, and two layouts based on it.

3DGStream has a folder per instant, ``frame000000/images/cam00.png``, and a model in the first; the "multipleview" layout of 4D
Gaussian Splatting has ``camXX/frame_00001.jpg`` and a model in ``sparse_/``.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.camera_frames import IN_WORDS, frames_in, listed, require_frames
from ggvs_eval.datasets.colmap_model import CalibratedView, median_depths, model_cameras, read_model, undistorted_sources
from ggvs_eval.datasets.frames import ImageFrames, NumberedFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.datasets.unread_files import first_bytes
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import IMAGE_SUFFIXES, list_entries, list_images
from ggvs_eval.files.names import camera_names

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0")
MARK = "frame[0-9]*"
INSTANT = re.compile(r"frame_?(\d{1,9})")
LONGEST_ROUNDING = 1e-3  # of a quaternion's length, as of the reader
SPARSE_MODEL = "sparse_"


def refuse_colmap(path: Path) -> str | None:
    """Return the reason why this is not a COLMAP capture, or None if it is one."""
    return None if find_model(path) else f"no COLMAP model (cameras.bin or cameras.txt) in {', '.join(MODEL_FOLDERS)}"


def load_colmap(path: Path, units: GivenUnits) -> Capture:
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
    notes = [f"{listed(frames.beside)} omitted: on disk, but not registered in the COLMAP model"] if frames.beside else []
    others = [
        each for each in _numbered_models(folder.parent / "0") if folder.name.isdecimal() and each != folder and _holds(each)
    ]
    if others:
        sizes = listed([f"{each.relative_to(path)} ({_n_images(each)})" for each in others])
        notes.append(f"{folder.relative_to(path)} is taken, the model of most images ({len(views)}); not read: {sizes}")
    scaled = [name for name, view in views.items() if abs(view.quaternion_length - 1) > LONGEST_ROUNDING]
    if scaled:
        lengths = f"the length {views[scaled[0]].quaternion_length:.4g}"
        notes.append(f"quaternions of {listed(scaled)} have {lengths}: brought to 1")
    return assemble_capture(path, "colmap", cameras, pinhole, chosen, notes=notes)


def find_model(path: Path) -> Path | None:
    """Return the folder of the first sparse model in or below a capture; of several by a mapper that of most images."""
    models = [folder for name in MODEL_FOLDERS for folder in _numbered_models(path / name) if _holds(folder)]
    if not models:
        return path if _holds(path) and any((path / f"images.{kind}").is_file() for kind in ("bin", "txt")) else None
    siblings = [folder for folder in models if folder.parent == models[0].parent]
    return max(siblings, key=_n_images) if len(siblings) > 1 else models[0]


def _numbered_models(folder: Path) -> list[Path]:
    """Return the folder, and those of other numbers next to it if it is called 0."""
    beside = [each for each in list_entries(folder.parent) if each.name.isdecimal()] if folder.name == "0" else []
    return beside or [folder]


def _holds(folder: Path) -> bool:
    return any((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))


def _n_images(folder: Path) -> int:
    """Return the number of images of a model, by its first bytes or by the rows that end with a picture's name."""
    if (folder / "images.bin").is_file():
        return int.from_bytes(first_bytes(folder / "images.bin")[:8], "little")
    rows = first_bytes(folder / "images.txt").decode(errors="replace").splitlines()
    return sum(row.rstrip().lower().endswith(IMAGE_SUFFIXES) for row in rows if not row.startswith("#"))


def by_camera(folder: Path, views: Sequence[CalibratedView]) -> dict[str, CalibratedView]:
    """Return the views of a model by the names of their cameras, see `camera_names`."""
    names = camera_names([view.image_name for view in views])
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        repeats = f"several images of {listed(twice)}"
        raise CaptureError(f"{folder}: wanted one registered image per fixed camera, got {repeats}; calibrate with one instant")
    return dict(sorted(zip(names, views, strict=True)))


COLMAP_LAYOUT = DatasetSpec(f"sparse/0 with {IN_WORDS}", refuse_colmap, load_colmap, ("sparse", "colmap"))


def refuse_frame_folders(path: Path) -> str | None:
    """Return the reason why this folder is no capture with a folder per instant, or None if it is one."""
    instants = numbered_folders(path, INSTANT)
    if not instants:
        return "no folders frame000000/images/"
    if find_model(path) or find_model(next(iter(instants.values()))):
        return None
    first = next(iter(instants.values())).name
    return f"{first}/, but no COLMAP model in it: 'ggvs-eval calibrate {path / first} RIG' creates one; copy its sparse/ there"


def load_frame_folders(path: Path, units: GivenUnits) -> Capture:
    """Open a capture; cameras are called as their images in the model, without suffix, in the order of names.

    Reading:
        The model of the first instant counts: the cameras do not move, and 3DGStream copies it to the others.
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
    notes = [f"{listed(left)} omitted: on disk, but not registered in the COLMAP model"] if left else []
    return assemble_capture(path, "3dgstream", cameras, pinhole, chosen, notes=notes)


def numbered_folders(parent: Path, name: re.Pattern[str]) -> dict[int, Path]:
    """Return the folders of instants with pictures in ``images/``, by their numbers, in the order of time."""
    matches = [(name.fullmatch(each.name), each) for each in sorted(parent.iterdir())] if parent.is_dir() else []
    numbered = {int(match[match.re.groups]): folder for match, folder in matches if match and list_images(folder / "images")}
    return dict(sorted(numbered.items()))


def instant_pictures(instants: dict[int, Path]) -> dict[str, list[tuple[int, Path]]]:
    """Return the pictures of each camera with the numbers of their instants, by the name of the picture."""
    pictures: dict[str, list[tuple[int, Path]]] = {}
    for number, folder in instants.items():
        for file in list_images(folder / "images"):
            pictures.setdefault(file.stem, []).append((number, file))
    return pictures


FRAME_FOLDERS_LAYOUT = DatasetSpec(
    "frame000000/images/camXX.png with sparse/0 in the first (3DGStream)", refuse_frame_folders, load_frame_folders, (MARK,)
)


def refuse_multipleview(path: Path) -> str | None:
    """Return the reason why this is not a multipleview capture, or None if it is one."""
    if not any((path / SPARSE_MODEL / f"cameras.{kind}").is_file() for kind in ("bin", "txt")):
        return f"no COLMAP model in {SPARSE_MODEL}/"
    return None if _folders(path) else "no folders camXX/ with images"


def load_multipleview(path: Path, units: GivenUnits) -> Capture:
    """Open a multipleview capture; cameras are called as their folders.

    Args:
        path: folder that holds ``sparse_/`` and ``camXX/``.

    Raises:
        CaptureError: the model is damaged, or folders and images of the model do not match.

    Reading:
        The image of camera ``cam07`` is called ``image7.jpg`` or ``image07.jpg`` in the model: the number counts.
    """
    folders = _numbered(path)
    views = _by_number(path, read_model(path / SPARSE_MODEL))
    missing = sorted(set(views) ^ set(folders))
    if missing:
        gaps = listed([f"cam{number:02d} ({'model' if number in views else 'folder'} only)" for number in missing])
        raise CaptureError(f"{path}: wanted a folder camXX/ per image of {SPARSE_MODEL}/, got {gaps}; restore or remove these")
    numbers = sorted(folders)
    cameras = model_cameras({folders[number].name: views[number] for number in numbers}, path / SPARSE_MODEL)
    sources = [ImageFrames(folders[number]) for number in numbers]
    chosen = choose_units(path, units, cameras, median_depths=median_depths(views.values()))
    pinhole = undistorted_sources(sources, [views[number].lens for number in numbers], cameras)
    return assemble_capture(path, "multipleview", cameras, pinhole, chosen)


def _folders(path: Path) -> list[Path]:
    return [frames.path for name, frames in frames_in(path, "CAM/") if re.fullmatch(r"cam\d{1,6}", name)]


def _numbered(path: Path) -> dict[int, Path]:
    """Return camera number -> its folder."""
    numbered: dict[int, Path] = {}
    for folder in _folders(path):
        other = numbered.setdefault(int(folder.name.removeprefix("cam")), folder)
        if other != folder:
            raise CaptureError(
                f"{path}: wanted one folder per camera, got {other.name} and {folder.name}; move the other out of the folder"
            )
    return numbered


def _by_number(path: Path, views: list[CalibratedView]) -> dict[int, CalibratedView]:
    numbered = {}
    for view in views:
        match = re.fullmatch(r"\D*(\d{1,6})\.\w+", view.image_name)
        if not match or int(match[1]) in numbered:
            raise CaptureError(
                f"{path / SPARSE_MODEL}: wanted images called image<number>.jpg, one per camera, got {view.image_name!r}"
            )
        numbered[int(match[1])] = view
    return numbered


MULTIPLEVIEW_LAYOUT = DatasetSpec("sparse_/ with camXX/frame_00001.jpg", refuse_multipleview, load_multipleview, ("sparse_",))
