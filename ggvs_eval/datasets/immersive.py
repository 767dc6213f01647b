"""Google Immersive (DeepView Video): videos of a hemispherical rig of fisheye cameras, with ``models.json``."""

import re
from pathlib import Path
from typing import Any, Final, NamedTuple

from ggvs_eval.arrays import Array
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size
from ggvs_eval.datasets.camera_frames import find_frames, listed
from ggvs_eval.datasets.colmap_model import undistorted_sources
from ggvs_eval.datasets.depth_range import Placed, ranged_cameras
from ggvs_eval.datasets.google_models import MODELS, CameraModel, load_models, read_camera_model, read_numbers
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.units import METRIC, GivenUnits, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.lens import Lens

CAMERA = re.compile(r"camera_\d{1,6}")
FISHEYE: Final = "fisheye"
# Number of a scene -> its nearest and farthest depth in metres, as HyperReel (Attal et al., CVPR 2023) samples it.
SCENE_DEPTHS_M = {
    "01": (0.25, 6.0),
    "02": (1.0, 10.0),
    "04": (0.5, 10.0),
    "05": (0.5, 45.0),
    "07": (0.5, 50.0),
    "09": (0.5, 30.0),
    "10": (0.25, 6.0),
    "11": (0.25, 6.0),
    "12": (0.5, 20.0),
}


class _View(NamedTuple):
    name: str
    model: CameraModel
    lens: Lens
    K: Array  # of its pinhole image


def refuse(path: Path) -> str | None:
    """Return the reason why this folder is not a scene of Google Immersive, or None if it is one."""
    if not (path / MODELS).is_file():
        return f"no {MODELS}"
    return None if any(path.glob("camera_*")) else f"{MODELS}, but no camera_XXXX"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a scene; frames are undistorted as they are read.

    Args:
        path: folder of the scene, with ``models.json`` and ``camera_XXXX.mp4``, or folders of the frames extracted from them.
        units: world units per metre or a file that says how to measure them; the data set is metric when None.

    Reading:
        The lens is the one of the data set's README: theta (1 + k1 theta^2 + k2 theta^4) focal lengths from the principal point,
        OpenCV's fisheye model with k3 = k4 = 0. The pinhole image has the fisheye image's size and focal length, without blank
        pixels, see `Lens.undistorted_K`: it shows the inner part of what the lens saw. Cameras of the file without frames are
        left out with a note, since the data set says that some scenes lack some. Depth range: what HyperReel takes for the scene
        by the number its folder begins with.
    """
    views = _read_views(path / MODELS)
    frames = find_frames(path, {view.name: view.name for view in views}).sources
    if not frames:
        raise CaptureError(f"{path}: wanted videos {views[0].name}.mp4, ..., or folders of their frames, got none; restore them")
    filmed = [view for view in views if view.name in frames]
    sources = [frames[view.name] for view in filmed]
    depths = SCENE_DEPTHS_M.get(path.resolve().name.partition("_")[0])
    rig = [Placed(view.name, view.K, view.model.world_to_camera, (view.lens.width, view.lens.height), depths) for view in filmed]
    cameras = ranged_cameras(rig, path / MODELS)
    pinhole = undistorted_sources(sources, [view.lens for view in filmed], cameras)
    absent = [view.name for view in views if view.name not in frames]
    notes = [f"{listed(absent)} left out: in {MODELS}, but without frames"] if absent else []
    return assemble_capture(
        path, "immersive", cameras, pinhole, choose_units(path, units, cameras, of_data_set=METRIC), notes=notes
    )


def _read_views(file: Path) -> list[_View]:
    models = load_models(file)
    if not isinstance(models, list) or not models:
        raise CaptureError(f"{file}: wanted a list of cameras, got something else; copy the scene again")
    check_rig_size(file, len(models))
    return [_read_view(file, index, model) for index, model in enumerate(models)]


def _read_view(file: Path, index: int, model: Any) -> _View:
    calibrated = read_camera_model(file, model, f"camera {index}")
    name = model.get("name")
    if not isinstance(name, str) or not CAMERA.fullmatch(name):
        raise CaptureError(f"{file}: wanted camera_XXXX as name of camera {index}, got {name!r:.60}; copy the scene again")
    if model.get("projection_type") != FISHEYE:
        content = f"{model.get('projection_type')!r:.60}"
        raise CaptureError(
            f"{file}: wanted {FISHEYE!r} as projection_type of {name}, got {content}; no other lens of this data set is "
            "documented: undistort its frames and describe them in capture.toml"
        )
    k1, k2, third = read_numbers(file, model, "radial_distortion", 3, name)
    if third:
        raise CaptureError(
            f"{file}: wanted 0 as third radial_distortion of {name}, which the data set's camera model does not have, "
            f"got {third:g}; copy the scene again"
        )
    try:
        lens = Lens(calibrated.K, FISHEYE, (k1, k2, 0.0, 0.0), round(calibrated.width), round(calibrated.height))
        return _View(name, calibrated, lens, lens.undistorted_K())
    except CameraError as error:
        raise CaptureError(f"{file}: {name}: {error}") from error


LAYOUT = DatasetSpec("models.json with camera_XXXX.mp4 (Google Immersive)", refuse, load, ("models.json",))
