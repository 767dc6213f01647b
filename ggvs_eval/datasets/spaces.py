"""Google Spaces: a rig of 16 cameras set up at several positions before a scene that stands still."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size
from ggvs_eval.datasets.depth_range import Placed, ranged_cameras
from ggvs_eval.datasets.frames import ImageFrames, as_calibrated, has_shape
from ggvs_eval.datasets.google_models import MODELS, CameraModel, load_models, read_camera_model
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.units import METRIC, GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import find_below


class _View(NamedTuple):
    """One camera at one position of the rig: its name, ``pos00_cam03``, its image and its calibration."""

    name: str
    file: Path
    model: CameraModel


def refuse(path: Path) -> str | None:
    """Return the reason why this folder is not a scene of Spaces, or None if it is one."""
    if not (path / MODELS).is_file():
        return f"no {MODELS}"
    return None if any(path.glob("cam_*")) else f"{MODELS}, but no cam_XX/"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a scene with all positions of the rig; see `load_positions`."""
    return load_positions(path, units, None)


def load_positions(path: Path, units: GivenUnits, positions: Sequence[int] | None) -> Capture:
    """Open a scene; every camera at every chosen position of the rig is one camera of a single instant, ``pos00_cam03``.

    Args:
        path: folder of the scene, with ``models.json`` and ``cam_XX/image_YYY.JPG``.
        units: world units per metre or a file that says how to measure them; the data set is metric when None.
        positions: positions of the rig, counted from 0; all of them when None.

    Raises:
        CaptureError: no such position, ``models.json`` is damaged, or an image is missing, damaged or of another shape.

    Reading:
        The images are taken for scaled, not cropped, where their size differs from that in the file.
    """
    views = _read_views(path)
    chosen = range(len(views)) if positions is None else positions
    absent = sorted(position for position in chosen if not 0 <= position < len(views))
    if absent:
        listed = ", ".join(map(str, absent))
        raise CaptureError(
            f"{path / MODELS}: wanted rig position {listed}, the scene has 0..{len(views) - 1}; choose among these"
        )
    rig = iter(ranged_cameras([_placed(view) for at in views for view in at], path / MODELS))
    by_position = [[(next(rig), view) for view in at] for at in views]
    taken = [each for position in chosen for each in by_position[position]]
    cameras, sources = [camera for camera, _ in taken], [_image(view) for _, view in taken]
    return assemble_capture(path, "spaces", cameras, sources, choose_units(path, units, cameras, of_data_set=METRIC))


def _read_views(path: Path) -> list[list[_View]]:
    """The views of each position of the rig."""
    file = path / MODELS
    models = load_models(file)
    if not isinstance(models, list) or not models or not all(isinstance(at, list) and at for at in models):
        raise CaptureError(
            f"{file}: wanted a list over rig positions of lists of cameras, got something else; copy the scene again"
        )
    check_rig_size(file, sum(map(len, models)))
    return [[_read_view(path, index, camera, model) for camera, model in enumerate(at)] for index, at in enumerate(models)]


def _read_view(path: Path, position: int, camera: int, model: Any) -> _View:
    where = f"camera {camera} of rig position {position}"
    calibrated = read_camera_model(path / MODELS, model, where)
    file = _read_path(path, model, f"cam_{camera:02d}/image_{position:03d}.JPG", where)
    return _View(f"pos{position:02d}_cam{camera:02d}", file, calibrated)


def _read_path(path: Path, model: dict[str, Any], usual: str, where: str) -> Path:
    """The image of a camera, which must lie within the scene."""
    relative = model.get("relative_path", usual)
    parts = PurePosixPath(relative).parts if isinstance(relative, str) else ()
    if (
        not parts
        or parts[0] == "/"
        or ".." in parts
        or not relative.isprintable()
        or set(relative) & set("\\:")
        or len(relative) > 200
    ):
        mend = "correct the file before you trust it"
        raise CaptureError(f"{path / MODELS}: wanted relative_path of {where} within the scene, got {relative!r:.60}; {mend}")
    return find_below(path, relative)


def _image(view: _View) -> ImageFrames:
    if not view.file.is_file():
        raise CaptureError(f"{view.file}: wanted the image of {view.name}, there is none; restore it or copy the scene again")
    return as_calibrated(ImageFrames(view.file), round(view.model.width), round(view.model.height))


def _placed(view: _View) -> Placed:
    """The camera at the size of its image on disk."""
    model, (width, height) = view.model, _image(view).size
    if not has_shape((width, height), (model.width, model.height)):
        calibrated = f"{model.width:g} x {model.height:g}"
        raise CaptureError(
            f"{view.file}: wanted the shape of {calibrated} that {view.name} is calibrated for, got {width} x {height}; "
            "give images that are scaled but not cropped"
        )
    K = np.diag([width / model.width, height / model.height, 1.0]) @ model.K
    return Placed(view.name, K, model.world_to_camera, (width, height))


LAYOUT = DatasetSpec("models.json with cam_XX/ (Google Spaces)", refuse, load, ("models.json",))
