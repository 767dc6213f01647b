"""COLMAP sparse models, binary and text, read as views with pose, pinhole intrinsics, lens and
depth range.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from struct import calcsize, unpack_from
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.camera import pinhole_K, rigid
from ggvs_eval.datasets.assemble import check_rig_size
from ggvs_eval.datasets.depth_range import FAR_MARGIN, NEAR_MARGIN
from ggvs_eval.datasets.rig import RigCamera
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.plain import parse_numbers, read_plain, read_plain_text
from ggvs_eval.lens import Lens, LensModel

PERCENTILES = (1, 50, 99)
FEWEST_POINTS = 10  # seen from a camera, of which a depth range can be taken
# COLMAP's lenses that OpenCV can express, with their parameters in order.
LENSES = """
    SIMPLE_PINHOLE f cx cy
    PINHOLE fx fy cx cy
    SIMPLE_RADIAL f cx cy k1
    RADIAL f cx cy k1 k2
    OPENCV fx fy cx cy k1 k2 p1 p2
    FULL_OPENCV fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
    SIMPLE_RADIAL_FISHEYE f cx cy k1
    RADIAL_FISHEYE f cx cy k1 k2
    OPENCV_FISHEYE fx fy cx cy k1 k2 k3 k4"""
COEFFICIENTS = {
    "fisheye": "k1 k2 k3 k4",
    "opencv": "k1 k2 p1 p2",
    "rational": "k1 k2 p1 p2 k3 k4 k5 k6",
}
LARGEST_MODEL_FILE = 512 << 20
# The lenses of binary models in the order of their numbers, each with how many parameters it has.
MODELS = """
    SIMPLE_PINHOLE 3 PINHOLE 4 SIMPLE_RADIAL 4 RADIAL 5 OPENCV 8 OPENCV_FISHEYE 8 FULL_OPENCV 12
    FOV 5 SIMPLE_RADIAL_FISHEYE 4 RADIAL_FISHEYE 5 THIN_PRISM_FISHEYE 12
    RAD_TAN_THIN_PRISM_FISHEYE 16 SIMPLE_DIVISION 4 DIVISION 5 SIMPLE_FISHEYE 3 FISHEYE 4 EUCM 6
    EQUIRECTANGULAR 2"""
BEYOND = [np.inf, 0.0, 0.0, 0.0]  # number and place of a point behind all others
SIGHTS = np.dtype([("uv", "<2f8"), ("point", "<i8")])


class ModelCamera(NamedTuple):
    """A camera of a model."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


class ModelImage(NamedTuple):
    """A registered image of a model.

    Attributes:
        pose: quaternion (w first) and translation of world to camera, (7,), as the file has them.
        points: numbers of the points that it sees; -1 for other features.
    """

    name: str
    pose: Array
    camera: ModelCamera
    points: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class CalibratedView:
    """One registered image of a model.

    Attributes:
        image_name: as the model calls it.
        world_to_camera: rigid transform, (4, 4).
        lens: intrinsics and distortion at the size of the calibration.
        depth_percentiles: 1st, 50th and 99th percentile of the depth of the points it sees, world
            units; None if it sees none.
        quaternion_length: of its rotation as the file has it, which is brought to 1.
    """

    image_name: str
    world_to_camera: Array
    lens: Lens
    depth_percentiles: tuple[float, float, float] | None
    quaternion_length: float = 1.0

    @property
    def numbers(self) -> Array:
        """Pose and intrinsics in one row."""
        return np.append(self.world_to_camera, self.lens.K)


def rig_of_views(views: Mapping[str, CalibratedView]) -> list[RigCamera]:
    """Return the rig of named views.

    Reading:
        near = 0.8 times the 1st, far = 1.2 times the 99th percentile of the depth of the points
        that a view sees. Points are for depth ranges alone: a view that sees none has none, as a
        model of known poses before triangulation.
    """
    rig = []
    for name, view in views.items():
        percentiles = view.depth_percentiles
        near_far = (
            (NEAR_MARGIN * percentiles[0], FAR_MARGIN * percentiles[2]) if percentiles else None
        )
        rig.append(
            RigCamera(
                name=name, lens=view.lens, world_to_camera=view.world_to_camera, near_far=near_far
            )
        )
    return rig


def median_depths(views: Iterable[CalibratedView]) -> list[float]:
    """Return the median depth of the points of each view that sees any, world units."""
    return [view.depth_percentiles[1] for view in views if view.depth_percentiles]


def read_model(folder: Path, suffix: str = "") -> list[CalibratedView]:
    """Return the registered images of a model in the order of their names.

    Args:
        folder: holds cameras, images and perhaps points3D, as text or binary.
        suffix: of the files; binary ones go first where it is empty.
    """
    suffix = suffix or (".bin" if (folder / "cameras.bin").is_file() else ".txt")
    try:
        images, points = (read_binary if suffix == ".bin" else read_text)(folder)
    except (OSError, ValueError, LookupError, ArithmeticError) as error:
        reason = (
            f"no {Path(error.filename).name}"
            if isinstance(error, FileNotFoundError)
            else str(error)
        )
        raise CaptureError(
            f"{folder}: damaged COLMAP model, {reason:.200}; copy or export the model again"
        ) from error
    check_rig_size(folder, len(images))
    if not images:
        raise CaptureError(
            f"{folder}: wanted one registered image per fixed camera, got none; calibrate again"
        )
    return [_view(folder, image, points) for image in sorted(images, key=lambda image: image.name)]


def _view(folder: Path, image: ModelImage, points: Array) -> CalibratedView:
    length = float(np.linalg.norm(image.pose[:4]))
    if not 0 < length < np.inf:
        raise CaptureError(
            f"{folder}: wanted a rotation of {image.name}, got a quaternion of length {length:g}; "
            f"calibrate again"
        )
    w, *axis = image.pose[:4] / length
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    world_to_camera = rigid(np.eye(3) + 2 * w * cross + 2 * cross @ cross, image.pose[4:])
    try:
        lens = lens_of_colmap(*image.camera)
    except CameraError as error:
        raise CaptureError(f"{folder}: {image.name}: {error}") from error
    at = np.searchsorted(points[:, 0], image.points)
    seen = points[at[points[at, 0] == image.points], 1:]
    depth = seen @ world_to_camera[2, :3] + world_to_camera[2, 3]
    depth = depth[depth > 0]
    percentiles = (
        tuple(np.percentile(depth, PERCENTILES).tolist()) if len(depth) >= FEWEST_POINTS else None
    )
    return CalibratedView(
        image_name=image.name,
        world_to_camera=world_to_camera,
        lens=lens,
        depth_percentiles=percentiles,
        quaternion_length=length,
    )


def lens_of_colmap(model: str, width: int, height: int, params: Sequence[float]) -> Lens:
    """Return the lens of a COLMAP camera.

    Raises:
        CameraError: a model that OpenCV cannot express, or parameters that do not fit it.
    """
    lenses = {name: keys for name, *keys in map(str.split, LENSES.strip().splitlines())}
    if model not in lenses:
        remedy = "undistort images and model by 'colmap image_undistorter' first"
        raise CameraError(f"wanted one of {', '.join(lenses)}, got {model}; {remedy}")
    if len(params) != len(lenses[model]) or not np.isfinite(params).all():
        raise CameraError(
            f"wanted {len(lenses[model])} finite parameters of {model}, got {list(params)}"
        )
    values = dict(zip(lenses[model], map(float, params), strict=True))
    kind: LensModel = "fisheye" if model.endswith("FISHEYE") else "opencv"
    keys = COEFFICIENTS["rational" if "k6" in values else kind].split()
    fx, fy = (values.get(key, values.get("f", 0.0)) for key in ("fx", "fy"))
    return Lens(
        K=pinhole_K(fx, fy, values["cx"], values["cy"]),
        model=kind,
        coefficients=tuple(values.get(key, 0.0) for key in keys),
        width=width,
        height=height,
    )


def read_binary(folder: Path) -> tuple[list[ModelImage], Array]:
    """Return the images and the points of a model: a number and a place each, (P, 4), in the order
    of numbers.

    Raises:
        ValueError: a file ends early or holds more than it says.
        LookupError: a camera that is not there.
    """
    names = MODELS.split()
    cameras = {}
    for file in _entries(folder / "cameras.bin"):
        number, model, width, height = file.take("IIQQ")
        cameras[number] = ModelCamera(
            model=names[2 * model],
            width=width,
            height=height,
            params=file.take(f"{names[2 * model + 1]}d"),
        )
    images = []
    for file in _entries(folder / "images.bin"):
        _, *pose, camera = file.take("I7dI")
        images.append(
            ModelImage(
                name=file.take_text(),
                pose=np.array(pose),
                camera=cameras[camera],
                points=file.take_points(),
            )
        )
    points = [BEYOND]
    cloud = folder / "points3D.bin"
    for file in _entries(cloud) if lexists(cloud) else ():
        *point, n_images = file.take("Q3d11xQ")
        points.append(point)
        file.skip(8 * n_images)
    return images, np.array(sorted(points))


class _Content:
    """The content of a binary file, taken piece by piece."""

    def __init__(self, file: Path) -> None:
        self.name, self.content, self.at = file.name, read_plain(file, LARGEST_MODEL_FILE), 0

    def take(self, form: str) -> tuple[Any, ...]:
        start = self.at
        self.skip(calcsize(f"<{form}"))
        return unpack_from(f"<{form}", self.content, start)

    def skip(self, n_bytes: int) -> None:
        self.at += n_bytes
        if self.at > len(self.content):
            raise self.damaged()

    def take_text(self) -> str:
        start, end = self.at, self.content.find(b"\0", self.at)
        self.skip(end + 1 - start if end >= start else len(self.content) + 1)
        return self.content[start:end].decode()

    def take_points(self) -> NDArray[np.int64]:
        (count,) = self.take("Q")
        start = self.at
        self.skip(SIGHTS.itemsize * count)
        return np.frombuffer(self.content, SIGHTS, count, start)["point"]

    def damaged(self) -> ValueError:
        return ValueError(
            f"{self.name} is cut or damaged, its {len(self.content)} bytes do not fit its content"
        )


def _entries(file: Path) -> Iterator[_Content]:
    """Yield the content as often as its first number says, which is all of it then."""
    content = _Content(file)
    for _ in range(*content.take("Q")):
        yield content
    if content.at < len(content.content):
        raise content.damaged()


def read_text(folder: Path) -> tuple[list[ModelImage], Array]:
    """Return the same of a text model.

    Reading:
        The line after an image's is the points that it sees, unless it is the row of an image
        itself. A name is the rest of its line.
    """
    cameras = {}
    for line, text in _lines(folder / "cameras.txt"):
        if text:
            number, model, *numbers = text.split()
            width, height, *params = _numbers(folder / "cameras.txt", line, numbers)
            cameras[int(number)] = ModelCamera(
                model=model, width=int(width), height=int(height), params=tuple(params)
            )
    images: list[ModelImage] = []
    is_image = False
    for line, text in _lines(folder / "images.txt"):
        words = text.split(maxsplit=9)
        if is_image and not _is_image(words):
            images[-1] = images[-1]._replace(points=np.array(text.split()[2::3], np.int64))
            is_image = False
        elif words:
            _, *pose, camera = _numbers(folder / "images.txt", line, words[:9])
            if len(words) < 10:
                raise ValueError(
                    f"images.txt, line {line}: wanted nine numbers and a name, got {len(words)} "
                    f"words"
                )
            images.append(
                ModelImage(
                    name=words[9],
                    pose=np.array(pose),
                    camera=cameras[int(camera)],
                    points=np.empty(0, np.int64),
                )
            )
            is_image = True
    points = [BEYOND]
    cloud = folder / "points3D.txt"
    for line, text in _lines(cloud) if lexists(cloud) else ():
        if text:
            points.append(_numbers(cloud, line, text.split(maxsplit=4)[:4]))
    return images, np.array(sorted(points))


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Yield the number and the text of each line, comments aside."""
    for line, text in enumerate(read_plain_text(file, LARGEST_MODEL_FILE).split("\n"), 1):
        if not text.lstrip().startswith("#"):
            yield line, text.strip()


def _is_image(words: list[str]) -> bool:
    """Tell whether a row where points are expected is an image's: nine numbers and a name."""
    try:
        return (
            len(words) == 10
            and bool([float(word) for word in words[:9]])
            and not words[9].replace(" ", "")[:1].isdecimal()
        )
    except ValueError:
        return False


def _numbers(file: Path, line: int, words: list[str]) -> list[float]:
    try:
        return parse_numbers(" ".join(words), line)[0]
    except ValueError as error:
        raise ValueError(f"{file.name}, {error}") from None
