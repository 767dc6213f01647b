"""RGB-D sequences: one moving camera with a depth sensor before a still scene, as ScanNet and HoloLens export them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import LARGEST_DEVIATION, ROUNDING, Camera, nearest_rotation
from ggvs_eval.capture import Capture, Extras
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size, listed
from ggvs_eval.datasets.depth_frames import DepthFrames, read_depth_png
from ggvs_eval.datasets.depth_range import FAR_MARGIN, NEAR_MARGIN
from ggvs_eval.datasets.frames import ImageFrames, list_images
from ggvs_eval.datasets.units import METRIC, GivenUnits, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.plain import read_plain_text

SCANNET = ("color", "depth", "pose", "intrinsic")
HOLOLENS = ("images", "depth", "poses.txt", "K.txt")
METRES_PER_STEP = 0.001
SAMPLED_FRAMES = 32  # of which the depth range is taken
# A principal point farther off the middle, in widths of the image, belongs to images of another size.
LARGEST_OFFSET = 0.15
# Where depth has another shape than colour, its intrinsics must fit it this well; within the stretch it has the same shape.
LEAST_OFFSET, LARGEST_STRETCH = 0.05, 0.02
# A sensor less far off the camera, in metres or radians, shifts depth by less than a pixel and is taken to stand in its place.
LEAST_EXTRINSIC = 1e-3
# Farther off than this, metres, two sensors are no RGB-D camera: the numbers are millimetres or belong to another device.
LARGEST_DISTANCE_M = 1.0


@dataclass(frozen=True, eq=False)
class _Sequence:
    """Files and calibration of an RGB-D sequence in either layout, by frame number.

    Attributes:
        images: colour image of each frame.
        depths: depth map of each frame.
        poses: camera_to_world of each frame, (4, 4); not finite where tracking was lost.
        K: intrinsics of the images, (3, 3), and the file that says so.
        K_depth: intrinsics of the depth maps likewise; None where they have the images' field of view.
        depth_to_colour: rigid transform of points in the depth camera's frame to the colour camera's, (4, 4), metres; None where
            they are one.
    """

    images: dict[int, Path]
    depths: dict[int, Path]
    poses: dict[int, Array]
    K: tuple[Array, Path]
    K_depth: tuple[Array, Path] | None
    depth_to_colour: Array | None = None


def refuse(path: Path) -> str | None:
    """Return the reason why this folder is not an RGB-D sequence, or None if it is one."""
    if _fits(path, SCANNET) or _fits(path, HOLOLENS):
        return None
    return f"neither {'/, '.join(SCANNET)}/ nor {', '.join(HOLOLENS)}"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a sequence; every frame is one camera of a single instant, called by its number in six digits, with its depth.

    Args:
        path: folder of the sequence.
        units: world units per metre or a file that says how to measure them; the poses are metric when None.

    Raises:
        CaptureError: fewer than two frames with a pose, or a file that is missing or damaged.

    Reading:
        Frames without a finite pose are left out, which the capture's notes say. Row i of ``poses.txt`` is the i-th image in the
        order of numbers: with these poses depth warped between frames of the HoloLens sequence agrees, also across its missing
        number; with the rows before or after it does not. Intrinsics are taken with pixel centres at halves. All cameras have one
        depth range, 0.8 times the smallest 1st and 1.2 times the largest 99th percentile among 32 evenly spaced depth maps: long
        sequences have thousands.
    """
    sequence = _read_sequence(path)
    kept = [number for number, pose in sequence.poses.items() if np.isfinite(pose).all()]
    if len(kept) < 2:
        raise CaptureError(
            f"{path}: wanted at least 2 frames with a finite pose, got {len(kept)} of {len(sequence.poses)}; track again"
        )
    sources = [ImageFrames(sequence.images[number]) for number in kept]
    size = _common_size(sources)
    _check_intrinsics(*sequence.K, size)
    limits = _depth_range([sequence.depths[number] for number in kept])
    _check_depth_size(sequence, kept, size)
    cameras = [_make_camera(path, number, sequence, size, limits) for number in kept]
    extras = [Extras(depth=_depth_source(sequence, number, size)) for number in kept]
    lost = [_name(number) for number in sequence.poses if number not in kept]
    notes = [f"{listed(lost)} left out: no finite pose, tracking was lost there"] if lost else []
    units_per_metre = choose_units(path, units, cameras, of_data_set=METRIC)
    return assemble_capture(path, "rgbd", cameras, sources, units_per_metre, extras=extras, notes=notes)


def _fits(path: Path, names: Sequence[str]) -> bool:
    return all((path / name).exists() for name in names)


def _read_sequence(path: Path) -> _Sequence:
    scannet = _fits(path, SCANNET)
    colour, depth, *_ = SCANNET if scannet else HOLOLENS
    images = _numbered(path / colour, list_images(path / colour))
    check_rig_size(path, len(images))
    depths = _numbered(path / depth, sorted((path / depth).glob("*.png")))
    _check_complete(images, depths, path / depth, "depth map")
    if not scannet:
        return _Sequence(images, depths, _read_pose_rows(path / HOLOLENS[2], list(images)), _read_K(path / HOLOLENS[3]), None)
    files = _numbered(path / "pose", sorted((path / "pose").glob("*.txt")))
    _check_complete(images, files, path / "pose", "pose")
    K, K_depth = (_read_K(path / "intrinsic" / f"intrinsic_{kind}.txt") for kind in ("color", "depth"))
    poses = {number: _read_matrix(files[number], (4,)) for number in images}
    return _Sequence(images, depths, poses, K, K_depth, _read_extrinsics(path / "intrinsic"))


def _numbered(folder: Path, files: Sequence[Path]) -> dict[int, Path]:
    """The files by the last number in their names, in the order of numbers."""
    files_by_number: dict[int, Path] = {}
    for file in files:
        numbers = re.findall(r"\d+", file.stem)
        if not numbers or int(numbers[-1]) in files_by_number:
            problem = f"a second one in {file.name}" if numbers else f"none in {file.name}"
            raise CaptureError(f"{folder}: wanted one number per frame, got {problem}; remove or rename it")
        files_by_number[int(numbers[-1])] = file
    return dict(sorted(files_by_number.items()))


def _check_complete(images: dict[int, Path], files: dict[int, Path], folder: Path, what: str) -> None:
    missing = [str(number) for number in images if number not in files]
    if missing or not images:
        gap = f"none for {listed(missing)}" if missing else "no images"
        raise CaptureError(f"{folder}: wanted a {what} for each of the {len(images)} images, got {gap}; export the frames again")


def _read_pose_rows(file: Path, numbers: list[int]) -> dict[int, Array]:
    values = _read_values(file)
    if values.size != 16 * len(numbers):
        expected_numbers = f"16 numbers for each of the {len(numbers)} images"
        raise CaptureError(f"{file}: wanted {expected_numbers}, got {values.size / 16:g} rows of 16; restore what is missing")
    return dict(zip(numbers, values.reshape(-1, 4, 4), strict=True))


def _read_K(file: Path) -> tuple[Array, Path]:
    matrix = _read_matrix(file, (3, 4))
    K = matrix[:3, :3]
    if not np.isfinite(matrix).all() or (K[2] != [0, 0, 1]).any() or K[0, 1] or K[1, 0] or min(K[0, 0], K[1, 1]) <= 0:
        raise CaptureError(f"{file}: wanted pinhole intrinsics without skew, got {K.round(3).tolist()}; export them again")
    return K, file


def _read_extrinsics(folder: Path) -> Array | None:
    """Read the extrinsics from depth to colour camera: depth_to_colour, (4, 4), metres; None where they are one camera.

    Reading:
        SensReader writes both matrices and does not say which way they run. ScanNet's own calibration code multiplies
        unprojected points of the depth camera by its extrinsic: it maps the sensor's frame to the device's. So does the colour
        camera's, and points_colour = inv(E_colour) E_depth points_depth. The poses are taken as the colour camera's.
    """
    colour, depth = (_read_extrinsic(folder / f"extrinsic_{kind}.txt") for kind in ("color", "depth"))
    relative = np.linalg.inv(colour) @ depth
    if np.abs(relative - np.eye(4)).max() <= LEAST_EXTRINSIC:
        return None
    distance_m = float(np.linalg.norm(relative[:3, 3]))
    if distance_m > LARGEST_DISTANCE_M:
        raise CaptureError(
            f"{folder / 'extrinsic_depth.txt'}: wanted a depth camera within {LARGEST_DISTANCE_M:g} m of the colour camera, got "
            f"{distance_m:g} m; write the extrinsics in metres"
        )
    return relative


def _read_extrinsic(file: Path) -> Array:
    """A rigid transform, (4, 4); the identity where there is no file."""
    matrix = _read_matrix(file, (4,)) if file.is_file() else np.eye(4)
    rotation = matrix[:3, :3]
    is_transform = np.isfinite(matrix).all() and np.allclose(matrix[3], [0, 0, 0, 1])
    nearest, deviation = nearest_rotation(rotation) if is_transform else (rotation, np.inf)
    if deviation > LARGEST_DEVIATION:
        values = f"{matrix.round(4).tolist()}"
        raise CaptureError(f"{file}: wanted a rotation and a translation, 4 x 4, got {values}; export the calibration again")
    if deviation > ROUNDING:
        matrix[:3, :3] = nearest
    return matrix


def _read_matrix(file: Path, sides: tuple[int, ...]) -> Array:
    values = _read_values(file)
    if values.size not in [side * side for side in sides]:
        shapes = " or ".join(f"{side} x {side}" for side in sides)
        raise CaptureError(f"{file}: wanted a matrix of {shapes} numbers, got {values.size} numbers; export it again")
    return values.reshape(2 * [round(values.size**0.5)])


def _read_values(file: Path) -> Array:
    try:
        return np.array([float(word) for word in read_plain_text(file).split()], dtype=np.float64)
    except (OSError, ValueError) as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise CaptureError(f"{file}: wanted a text file of numbers, got: {reason:.120}; export it again") from error


def _common_size(sources: Sequence[ImageFrames]) -> tuple[int, int]:
    size = sources[0].size
    for source in sources:
        if source.size != size:
            first, other = (f"{width} x {height}" for width, height in (size, source.size))
            raise CaptureError(f"{source.path}: wanted {first} like the first image, got {other}; export the frames again")
    return size


def _check_depth_size(sequence: _Sequence, kept: Sequence[int], size: tuple[int, int]) -> None:
    """Depth maps have one size, of the shape of the images or one that their own intrinsics bear out."""
    depth_size = _common_size([ImageFrames(sequence.depths[number]) for number in kept])
    same_shape = abs(depth_size[0] * size[1] / (depth_size[1] * size[0]) - 1) < LARGEST_STRETCH
    if sequence.K_depth:
        _check_intrinsics(*sequence.K_depth, depth_size, LARGEST_OFFSET if same_shape else LEAST_OFFSET)
    elif not same_shape:
        image_size, map_size = (f"{width} x {height}" for width, height in (size, depth_size))
        file = sequence.depths[kept[0]]
        raise CaptureError(
            f"{file}: wanted depth of the shape of its {image_size} image, got {map_size}; export it without cropping"
        )


def _check_intrinsics(K: Array, file: Path, size: tuple[int, int], largest_offset: float = LARGEST_OFFSET) -> None:
    """Text files of intrinsics do not say for which size they are; resized images show by the principal point."""
    offsets = [abs(K[axis, 2] - size[axis] / 2) / size[axis] for axis in (0, 1)]
    if max(offsets) > largest_offset:
        place, point = f"a principal point near the middle of {size[0]} x {size[1]} images", f"({K[0, 2]:g}, {K[1, 2]:g})"
        raise CaptureError(f"{file}: wanted {place}, got {point}; scale the intrinsics as the images were scaled")


def _depth_range(files: Sequence[Path]) -> tuple[float, float]:
    chosen = np.unique(np.linspace(0, len(files) - 1, SAMPLED_FRAMES).round().astype(int))
    maps = (read_depth_png(files[index]) for index in chosen)
    percentiles = [np.percentile(steps[steps > 0], (1, 99)) for steps in maps]
    nearest, farthest = np.min(percentiles, axis=0)[0], np.max(percentiles, axis=0)[1]
    return float(NEAR_MARGIN * METRES_PER_STEP * nearest), float(FAR_MARGIN * METRES_PER_STEP * farthest)


def _make_camera(path: Path, number: int, sequence: _Sequence, size: tuple[int, int], limits: tuple[float, float]) -> Camera:
    camera_to_world = sequence.poses[number]
    if not np.allclose(camera_to_world[3], [0, 0, 0, 1]):
        last_row = f"the last row {camera_to_world[3].tolist()}"
        raise CaptureError(f"{path}: wanted a camera-to-world matrix for frame {number}, got {last_row}; export the poses again")
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = camera_to_world[:3, :3].T
    world_to_camera[:3, 3] = -camera_to_world[:3, :3].T @ camera_to_world[:3, 3]
    try:
        return Camera(_name(number), sequence.K[0], world_to_camera, *size, *limits)
    except CameraError as error:
        raise CaptureError(f"{path}: pose of frame {number}: {error}") from error


def _depth_source(sequence: _Sequence, number: int, size: tuple[int, int]) -> DepthFrames:
    file = sequence.depths[number]
    K, K_depth = (sequence.K[0], sequence.K_depth[0]) if sequence.K_depth else (None, None)
    return DepthFrames(file, METRES_PER_STEP, *size, K, K_depth, sequence.depth_to_colour)


def _name(number: int) -> str:
    return f"{number:06d}"
