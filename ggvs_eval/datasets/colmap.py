"""Captures calibrated by COLMAP: a sparse model and one image, image folder or video per camera,
and two layouts based on it.

3DGStream has a folder per instant, ``frame000000/images/cam00.png``, and a model in the first; the
"multipleview" layout of 4D Gaussian Splatting has ``camXX/frame_00001.jpg`` and a model in
``sparse_/``.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.camera_frames import IN_WORDS, find_frames
from ggvs_eval.datasets.colmap_model import CalibratedView, median_depths, read_model, rig_of_views
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.media import folders_beside
from ggvs_eval.datasets.rig import pinhole_rig
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.datasets.unread_files import first_bytes
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import IMAGE_SUFFIXES, list_entries, list_images
from ggvs_eval.files.names import camera_names, listed

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0")
MARK = "frame[0-9]*"
SAME = (1e-4, 1e-4)  # relative and absolute, of numbers that were written with few digits
LONGEST_ROUNDING = 1e-3  # of a quaternion's length, as of the reader
SPARSE_MODEL = "sparse_"


def refuse_colmap(path: Path) -> str | None:
    """Return the reason why this is not a COLMAP capture, or None if it is one."""
    return (
        None
        if find_model(path)
        else f"no COLMAP model (cameras.bin or cameras.txt) in {', '.join(MODEL_FOLDERS)}"
    )


def load_colmap(path: Path, units: GivenUnits, layout: str = "colmap") -> Capture:
    """Open a capture by its COLMAP model.

    Cameras are called as their images or folders in the model, in the order of names.

    Frames of a distorting camera are undistorted as they are read. Images on disk that the model
    did not register are noted.

    Raises:
        CaptureError: the model is damaged, or a camera of the model has no frames on disk.

    Reading:
        3DGStream copies the model of the first instant to the others. In the multipleview layout
        ``cam07`` is ``image7.jpg`` or ``image07.jpg`` of the model, and the folder names the
        camera.
    """
    is_multipleview = layout == "multipleview"
    folder = path / SPARSE_MODEL if is_multipleview else find_model(path) or path
    views = by_camera(folder, read_model(folder))
    frames = find_frames(
        path, {name: view.image_name for name, view in views.items()}, fewest=len(views)
    )
    notes = [] if is_multipleview else [*frames.notes]
    notes += (
        [f"{listed(frames.beside)} omitted: on disk, but not registered in the COLMAP model"]
        if frames.beside
        else []
    )
    if not is_multipleview and (other_models := _models(path)[1:]):
        sizes = listed([f"{each.relative_to(path)} ({_n_images(each)})" for each in other_models])
        notes.append(
            f"{folder.relative_to(path)} is taken, the model of most images ({len(views)}); not "
            f"read: {sizes}"
        )
    if differing := _differing(folder, views):
        of_text = (
            f"{folder.relative_to(path)}: cameras.bin is read; cameras.txt beside it has "
            f"another calibration of"
        )
        notes.append(f"{of_text} {listed(differing)}; keep the model that is meant")
    scaled = [
        name for name, view in views.items() if abs(view.quaternion_length - 1) > LONGEST_ROUNDING
    ]
    if scaled:
        lengths = f"the length {views[scaled[0]].quaternion_length:.4g}"
        notes.append(f"quaternions of {listed(scaled)} have {lengths}: brought to 1")
    depths = median_depths(views.values())
    if is_multipleview:
        views = dict(sorted((frames.sources[name].path.name, view) for name, view in views.items()))
        frames = frames._replace(
            sources={source.path.name: source for source in frames.sources.values()}
        )
    sources = [frames.sources[name] for name in views]
    cameras, pinhole = pinhole_rig(rig_of_views(views), sources, folder, path)
    return assemble_capture(
        path,
        layout,
        cameras,
        pinhole,
        choose_units(path, units, cameras, median_depths=depths),
        notes=notes,
    )


def _differing(folder: Path, views: Mapping[str, CalibratedView]) -> list[str]:
    """Return the views that text files beside a binary model place elsewhere, or give
    another lens.
    """
    if not all((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt")):
        return []
    try:
        texts = {view.image_name: view.numbers for view in read_model(folder, ".txt")}
    except CaptureError:
        texts = {}
    return [
        name
        for name, view in views.items()
        if not np.allclose(view.numbers, texts.get(view.image_name, np.nan), *SAME)
    ]


def find_model(path: Path) -> Path | None:
    """Return the folder of the first sparse model in or below a capture.

    Of several by a mapper that of most images.
    """
    return next(iter(_models(path)), None)


def _models(path: Path) -> list[Path]:
    """Return that model, and those of other numbers next to it."""
    places = [path] if (first := first_instant(path)) is None else [first, path]
    for folder in (place / name for place in places for name in MODEL_FOLDERS):
        beside = (
            [each for each in list_entries(folder.parent) if each.name.isdecimal()]
            if folder.name == "0"
            else []
        )
        if models := [model for model in beside or [folder] if _holds(model)]:
            return sorted(models, key=_n_images, reverse=True) if len(models) > 1 else models
    places = [
        place
        for folder in folders_beside(path)
        for place in (folder, *(folder / name for name in MODEL_FOLDERS))
    ]
    beside = [place for place in places if _holds(place) and _n_images(place)]
    return beside[:1] if len(beside) == 1 or path in beside else []


def _holds(folder: Path) -> bool:
    return any((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))


def _n_images(folder: Path) -> int:
    """Return the number of images of a model, by its first bytes or by the rows that end with a
    picture's name.
    """
    if (folder / "images.bin").is_file():
        return int.from_bytes(first_bytes(folder / "images.bin")[:8], "little")
    rows = first_bytes(folder / "images.txt").decode(errors="replace").splitlines()
    return sum(
        row.rstrip().lower().endswith(IMAGE_SUFFIXES) for row in rows if not row.startswith("#")
    )


def by_camera(folder: Path, views: Sequence[CalibratedView]) -> dict[str, CalibratedView]:
    """Return the views of a model by the names of their cameras, see `camera_names`."""
    names = camera_names([view.image_name for view in views])
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        repeats = f"several images of {listed(twice)}"
        raise CaptureError(
            f"{folder}: wanted one registered image per fixed camera, got {repeats}; calibrate "
            f"with one instant"
        )
    return dict(sorted(zip(names, views, strict=True)))


COLMAP_LAYOUT = DatasetSpec(
    describe=f"sparse/0 with {IN_WORDS}",
    refuse=refuse_colmap,
    load=load_colmap,
    marks=("sparse", "colmap"),
)


def refuse_frame_folders(path: Path) -> str | None:
    """Return the reason why this folder is no capture with a folder per instant, or None if it is
    one.
    """
    first = first_instant(path)
    if first is None:
        return "no folders frame000000/images/"
    if find_model(path):
        return None
    return (
        f"{first.name}/, but no COLMAP model in it: 'ggvs-eval calibrate {first} RIG' creates "
        f"one; copy its sparse/ there"
    )


def first_instant(path: Path) -> Path | None:
    """Return the first of the folders of instants with pictures in ``images/``."""
    return min(
        (folder for folder in path.glob(MARK) if list_images(folder / "images")), default=None
    )


FRAME_FOLDERS_LAYOUT = DatasetSpec(
    describe="frame000000/images/camXX.png with sparse/0 in the first (3DGStream)",
    refuse=refuse_frame_folders,
    load=partial(load_colmap, layout="3dgstream"),
    marks=(MARK,),
)


def refuse_multipleview(path: Path) -> str | None:
    """Return the reason why this is not a multipleview capture, or None if it is one."""
    return None if _holds(path / SPARSE_MODEL) else f"no COLMAP model in {SPARSE_MODEL}/"


MULTIPLEVIEW_LAYOUT = DatasetSpec(
    describe="sparse_/ with camXX/frame_00001.jpg",
    refuse=refuse_multipleview,
    load=partial(load_colmap, layout="multipleview"),
    marks=("sparse_",),
)
