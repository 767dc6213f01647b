"""Google's light fields, calibrated by ``models.json`` in metres: Spaces and Immersive (DeepView
Video).
"""

import json
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import pinhole_K, rigid
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size, known_depths
from ggvs_eval.datasets.camera_frames import find_frames
from ggvs_eval.datasets.entries import plain_numbers
from ggvs_eval.datasets.frames import ImageFrames, as_calibrated
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.rig import RigCamera, pinhole_camera, pinhole_rig
from ggvs_eval.datasets.units import METRIC, GivenUnits, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.listing import find_below
from ggvs_eval.files.names import is_inside
from ggvs_eval.files.plain import read_plain_text
from ggvs_eval.lens import Lens

MODELS = "models.json"
# What every camera of the file must say, and how many numbers each is.
NUMBERS = (
    "principal_point 2 pixel_aspect_ratio 1 focal_length 1 position 3 orientation 3 width 1 "
    "height 1"
)
CAMERA = re.compile(r"camera_\d{1,6}")
FISHEYE: Final = "fisheye"


# K, (3, 3), the size that it is for, pixels, and world_to_camera, (4, 4), metres.
Calibration = tuple[Array, tuple[int, int], Array]


def load_models(file: Path) -> Any:
    """Read the file without changes."""
    try:
        return json.loads(read_plain_text(file))
    except (OSError, ValueError, RecursionError) as error:
        reason = "lists nested too deep" if isinstance(error, RecursionError) else str(error)
        raise CaptureError(f"{file}: wanted JSON, got: {reason}; copy the scene again") from error


def read_camera_model(file: Path, model: Any, where: str) -> Calibration:
    """Read the calibration of one camera.

    Raises:
        CaptureError: a key that is absent or holds something else than finite numbers, or no size.

    Reading:
        ``orientation`` is the rotation vector of world to camera, ``position`` the camera's centre,
        and the principal point counts from the image's corner. Sizes of images that were scaled are
        seldom whole numbers, and K is brought to whole ones.
    """
    values = {
        key: read_numbers(file, model, key, int(count), where)
        for key, count in re.findall(r"(\w+) (\d)", NUMBERS)
    }
    focal_px, aspect = *values["focal_length"], *values["pixel_aspect_ratio"]
    (cx, cy), (width,), (height,) = values["principal_point"], values["width"], values["height"]
    if width < 1 or height < 1:
        raise CaptureError(
            f"{file}: wanted a size of {where}, got {width:g} x {height:g}; copy the scene again"
        )
    rotation = cv2.Rodrigues(np.array(values["orientation"]))[0]
    size = round(width), round(height)
    K = np.diag([size[0] / width, size[1] / height, 1.0]) @ pinhole_K(
        focal_px, focal_px * aspect, cx, cy
    )
    return K, size, rigid(rotation, -rotation @ values["position"])


def read_numbers(file: Path, model: Any, key: str, count: int, where: str) -> list[float]:
    """Read `count` numbers of one key, whether the file holds a list or a single one.

    Otherwise as `read_camera_model`.
    """
    value = model.get(key) if isinstance(model, Mapping) else None
    numbers = plain_numbers(value).ravel()
    # Beyond this nothing is a length or an angle.
    if len(numbers) != count or not (np.abs(numbers) < 1e9).all():
        requirement = f"{count} finite numbers" if count > 1 else "a finite number"
        content = (
            f"{value!r:.60}" if isinstance(model, Mapping) else f"{model!r:.60} for the camera"
        )
        raise CaptureError(
            f"{file}: wanted {requirement} as {key} of {where}, got {content}; copy the scene again"
        )
    return [*map(float, numbers)]


def _refuse(cameras: str, described: str, path: Path) -> str | None:
    """Return the reason why this folder is not a scene of a data set, by how that calls its
    cameras, or None if it is one.
    """
    if not (path / MODELS).is_file():
        return f"no {MODELS}"
    return None if any(path.glob(cameras)) else f"{MODELS}, but no {described}"


def load_positions(path: Path, units: GivenUnits) -> Capture:
    """Open a scene; every camera at every position of the rig is one camera of a single instant,
    ``pos00_cam03``.

    Args:
        path: folder of the scene, with ``models.json`` and ``cam_XX/image_YYY.JPG``.
        units: world units per metre or a file that says how to measure them; the data set is metric
            when None.

    Raises:
        CaptureError: ``models.json`` is damaged, or an image is missing, damaged or of another
            shape.

    Reading:
        The images are taken for scaled, not cropped, where their size differs from that in the
        file.
    """
    file = path / MODELS
    rig, images = [], []
    for position, camera, model in _read_positions(file):
        where = f"camera {camera} of rig position {position}"
        calibration = read_camera_model(file, model, where)
        image = _read_path(path, model, f"cam_{camera:02d}/image_{position:03d}.JPG", where)
        if not image.is_file():
            raise CaptureError(
                f"{image}: wanted the image of {where}, got none; restore it or copy the scene "
                f"again"
            )
        rig.append(pinhole_camera(file, f"pos{position:02d}_cam{camera:02d}", *calibration))
        images.append(as_calibrated(ImageFrames(image), *calibration[1]))
    cameras, sources = pinhole_rig(rig, images, file, path)
    return assemble_capture(
        path, "spaces", cameras, sources, choose_units(path, units, cameras, of_data_set=METRIC)
    )


def _read_positions(file: Path) -> list[tuple[int, int, Any]]:
    """Return position, camera and model of each view."""
    models = load_models(file)
    if (
        not isinstance(models, list)
        or not models
        or not all(isinstance(at, list) and at for at in models)
    ):
        raise CaptureError(
            f"{file}: wanted a list over rig positions of lists of cameras, got another structure; "
            f"copy the scene again"
        )
    check_rig_size(file, sum(map(len, models)))
    return [(position, *camera) for position, at in enumerate(models) for camera in enumerate(at)]


def _read_path(path: Path, model: dict[str, Any], usual: str, where: str) -> Path:
    """Return the image of a camera, which must be inside the scene's folder."""
    relative = model.get("relative_path", usual)
    if not isinstance(relative, str) or not is_inside(relative) or set(relative) & set("\\:"):
        remedy = "correct the file before you trust it"
        raise CaptureError(
            f"{path / MODELS}: wanted relative_path of {where} within the scene, got "
            f"{relative!r:.60}; {remedy}"
        )
    return find_below(path, relative)


SPACES_LAYOUT = DatasetSpec(
    describe="models.json with cam_XX/ (Google Spaces)",
    refuse=partial(_refuse, "cam_*", "cam_XX/"),
    load=load_positions,
    marks=("models.json",),
)


def load_immersive(path: Path, units: GivenUnits) -> Capture:
    """Open a scene; frames are undistorted as they are read.

    Args:
        path: folder of the scene, with ``models.json`` and ``camera_XXXX.mp4``, or folders of the
            frames extracted from them.
        units: world units per metre or a file that says how to measure them; the data set is metric
            when None.

    Reading:
        The lens is the one of the data set's README: theta (1 + k1 theta^2 + k2 theta^4) focal
        lengths from the principal point, OpenCV's fisheye model with k3 = k4 = 0. The pinhole image
        has the fisheye image's size and focal length, without blank pixels, see
        `Lens.undistorted_K`: it shows the inner part of what the lens saw. Cameras of the file
        without frames are left out with a note, since the data set says that some scenes lack some.
        Depth range: what HyperReel takes for the scene by the number its folder begins with.
    """
    views = _read_immersive(path / MODELS)
    found_frames = find_frames(path, {view.name: view.name for view in views})
    filmed = [view for view in views if view.name in found_frames.sources]
    depths = known_depths("immersive", path.resolve().name.partition("_")[0])
    rig = [view._replace(near_far=depths) for view in filmed]
    cameras, pinhole = pinhole_rig(
        rig, [found_frames.sources[view.name] for view in filmed], path / MODELS, path
    )
    scale = choose_units(path, units, cameras, of_data_set=METRIC)
    return assemble_capture(path, "immersive", cameras, pinhole, scale, notes=found_frames.notes)


def _read_immersive(file: Path) -> list[RigCamera]:
    models = load_models(file)
    if not isinstance(models, list) or not models:
        raise CaptureError(
            f"{file}: wanted a list of cameras, got another structure; copy the scene again"
        )
    check_rig_size(file, len(models))
    return [_read_immersive_view(file, index, model) for index, model in enumerate(models)]


def _read_immersive_view(file: Path, index: int, model: Any) -> RigCamera:
    K, size, pose = read_camera_model(file, model, f"camera {index}")
    name = model.get("name")
    if not isinstance(name, str) or not CAMERA.fullmatch(name):
        raise CaptureError(
            f"{file}: wanted camera_XXXX as name of camera {index}, got {name!r:.60}; copy the "
            f"scene again"
        )
    if model.get("projection_type") != FISHEYE:
        content = f"{model.get('projection_type')!r:.60}"
        raise CaptureError(
            f"{file}: wanted {FISHEYE!r} as projection_type of {name}, got {content}; no other "
            "lens of this data set is documented; undistort its frames and list them in "
            "capture.toml"
        )
    k1, k2, third = read_numbers(file, model, "radial_distortion", 3, name)
    if third:
        raise CaptureError(
            f"{file}: wanted 0 as third radial_distortion of {name}, which the data set's camera "
            f"model does not have, got {third:g}; copy the scene again"
        )
    try:
        lens = Lens(K, FISHEYE, (k1, k2, 0.0, 0.0), *size)
        return RigCamera(name, lens, pose, K=lens.undistorted_K())
    except CameraError as error:
        raise CaptureError(f"{file}: {name}: {error}") from error


IMMERSIVE_LAYOUT = DatasetSpec(
    describe="models.json with camera_XXXX.mp4 (Google Immersive)",
    refuse=partial(_refuse, "camera_*", "camera_XXXX"),
    load=load_immersive,
    marks=("models.json",),
)
