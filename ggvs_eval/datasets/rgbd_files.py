"""Files of RGB-D sequences: ScanNet's export, HoloLens', 7-Scenes' and TUM's."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import LARGEST_DEVIATION, ROUNDING, nearest_rotation, rigid
from ggvs_eval.datasets.assemble import check_rig_size
from ggvs_eval.datasets.instants import find_partners
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import list_files, list_images
from ggvs_eval.files.names import listed, numbers_in
from ggvs_eval.files.picture_header import read_picture_header
from ggvs_eval.files.plain import parse_numbers, read_plain_text

SCANNET = ("color", "depth", "pose", "intrinsic")
HOLOLENS = ("images", "depth", "poses.txt", "K.txt")
TUM = ("rgb", "depth", "groundtruth.txt")
SEVEN_SCENES = "frame-*.pose.txt"
MARKS = (SEVEN_SCENES, "groundtruth.txt", "poses.txt")
# next to the frames of 7-Scenes or TUM, where they are another camera's
INTRINSICS = "camera-intrinsics.txt"
# What the authors of both data sets give for all their sequences, with the first pixel's centre at
# (0, 0); TUM's depth is registered to the colour camera with these.
KINECT_SIZE = (640, 480)
SEVEN_SCENES_K: Array = np.array([[585.0, 0, 320], [0, 585, 240], [0, 0, 1]])
TUM_K: Array = np.array([[525.0, 0, 319.5], [0, 525, 239.5], [0, 0, 1]])
MILLIMETRE, TUM_STEP = 0.001, 1 / 5000  # metres per step of the depth maps
# between colour, depth and pose of a frame, as TUM's own tool associates them
SAME_INSTANT_S = 0.02
# A sensor less far off the camera, in metres or radians, shifts depth by less than a pixel and is
# taken to coincide with it.
LEAST_EXTRINSIC = 1e-3
# Farther off than this, metres, two sensors are no RGB-D camera: the numbers are millimetres or
# belong to another device.
LARGEST_DISTANCE_M = 1.0


@dataclass(frozen=True, eq=False)
class RgbdSequence:
    """Files and calibration of an RGB-D sequence in either layout, by frame number.

    Attributes:
        images: colour image of each frame.
        depths: depth map of each frame.
        poses: camera_to_world of each frame, (4, 4); not finite where tracking was lost.
        K: intrinsics of the images, (3, 3), and the file that says so.
        K_depth: the same for the depth maps; None if they have the images' field of view.
        depth_to_colour: rigid transform of points in the depth camera's frame to the colour
            camera's, (4, 4), metres; None where they are one.
        note: what was left out and why; empty if nothing was.
    """

    images: dict[int, Path]
    depths: dict[int, Path]
    poses: dict[int, Array]
    K: tuple[Array, Path]
    K_depth: tuple[Array, Path] | None
    depth_to_colour: Array | None = None
    metres_per_step: float = MILLIMETRE
    note: str = ""


def is_sequence(path: Path) -> bool:
    """Return whether a folder holds a sequence in one of these forms."""
    return any(_fits(path, names) for names in (SCANNET, HOLOLENS, TUM)) or any(
        path.glob(SEVEN_SCENES)
    )


def _fits(path: Path, names: Sequence[str]) -> bool:
    return all((path / name).exists() for name in names)


def read_sequence(path: Path) -> RgbdSequence:
    """Read calibration and poses of a sequence, and find its pictures.

    Reading:
        Row i of ``poses.txt`` is the i-th image in the order of numbers: with these poses depth
        warped between frames of the HoloLens sequence agrees, also across its missing number; with
        the rows before or after it does not. 7-Scenes and TUM state one camera for all sequences,
        which is taken for images of its size; others want `INTRINSICS`. TUM's pose and depth of a
        frame are the nearest in time; frames without both within 0.02 s are left out.
    """
    if _fits(path, TUM):
        return _read_tum(path)
    if any(path.glob(SEVEN_SCENES)):
        return _read_seven_scenes(path)
    scannet = _fits(path, SCANNET)
    colour, depth, *_ = SCANNET if scannet else HOLOLENS
    images = _numbered(path / colour, list_images(path / colour))
    check_rig_size(path, len(images))
    depths = _numbered(path / depth, list_files(path / depth, (".png",)))
    _check_complete(images, depths, path / depth, "depth map")
    if not scannet:
        return RgbdSequence(
            images=images,
            depths=depths,
            poses=_read_pose_rows(path / HOLOLENS[2], list(images)),
            K=_read_K(path / HOLOLENS[3]),
            K_depth=None,
        )
    files = _numbered(path / "pose", list_files(path / "pose", (".txt",)))
    _check_complete(images, files, path / "pose", "pose")
    K, K_depth = (
        _read_K(path / "intrinsic" / f"intrinsic_{kind}.txt") for kind in ("color", "depth")
    )
    poses = {number: _read_matrix(files[number], (4,)) for number in images}
    return RgbdSequence(
        images=images,
        depths=depths,
        poses=poses,
        K=K,
        K_depth=K_depth,
        depth_to_colour=_read_extrinsics(path / "intrinsic"),
    )


def _numbered(folder: Path, files: Sequence[Path]) -> dict[int, Path]:
    """Return the files by the last number in their names, in the order of numbers."""
    files_by_number: dict[int, Path] = {}
    try:
        numbers = numbers_in(
            [
                file.stem.partition(".")[0] if file.name.startswith("frame-") else file.stem
                for file in files
            ]
        )
    except ValueError as error:
        raise CaptureError(
            f"{folder}: wanted one number per frame that can be read in one way, got {error}"
        ) from error
    for file, number in zip(files, numbers, strict=True):
        if not isinstance(number, int) or number in files_by_number:
            problem = (
                f"none in {file.name}"
                if not isinstance(number, int)
                else f"a second one in {file.name}"
            )
            raise CaptureError(
                f"{folder}: wanted one whole number per frame, got {problem}; rename it or move it "
                f"elsewhere"
            )
        files_by_number[number] = file
    return dict(sorted(files_by_number.items()))


def _check_complete(
    images: dict[int, Path], files: dict[int, Path], folder: Path, noun: str
) -> None:
    missing = [str(number) for number in images if number not in files]
    if missing or not images:
        gap = f"none for {listed(missing)}" if missing else "no images"
        raise CaptureError(
            f"{folder}: wanted a {noun} for each of the {len(images)} images, got {gap}; export "
            f"the frames again"
        )


def _read_pose_rows(file: Path, numbers: list[int]) -> dict[int, Array]:
    values = _read_values(file)
    if values.size != 16 * len(numbers):
        expected_numbers = f"16 numbers for each of the {len(numbers)} images"
        raise CaptureError(
            f"{file}: wanted {expected_numbers}, got {values.size / 16:g} rows of 16; restore what "
            f"is missing"
        )
    return dict(zip(numbers, values.reshape(-1, 4, 4), strict=True))


def _read_K(file: Path) -> tuple[Array, Path]:
    matrix = _read_matrix(file, (3, 4))
    K = matrix[:3, :3]
    if (
        not np.isfinite(matrix).all()
        or (K[2] != [0, 0, 1]).any()
        or K[0, 1]
        or K[1, 0]
        or min(K[0, 0], K[1, 1]) <= 0
    ):
        raise CaptureError(
            f"{file}: wanted pinhole intrinsics without skew, got {K.round(3).tolist()}; export "
            f"them again"
        )
    return K, file


def _read_extrinsics(folder: Path) -> Array | None:
    """Read the extrinsics from depth to colour camera: depth_to_colour, (4, 4), metres.

    None if they are one camera.

    Reading:
        SensReader writes both matrices and does not say which way they run. ScanNet's own
        calibration code multiplies unprojected points of the depth camera by its extrinsic: it maps
        the sensor's frame to the device's. So does the colour camera's, and points_colour =
        inv(E_colour) E_depth points_depth. The poses are taken as the colour camera's.
    """
    colour, depth = (
        _read_extrinsic(folder / f"extrinsic_{kind}.txt") for kind in ("color", "depth")
    )
    relative = np.linalg.inv(colour) @ depth
    if np.abs(relative - np.eye(4)).max() <= LEAST_EXTRINSIC:
        return None
    distance_m = float(np.linalg.norm(relative[:3, 3]))
    if distance_m > LARGEST_DISTANCE_M:
        raise CaptureError(
            f"{folder / 'extrinsic_depth.txt'}: wanted a depth camera within "
            f"{LARGEST_DISTANCE_M:g} m of the colour camera, got "
            f"{distance_m:g} m; write the extrinsics in metres"
        )
    return relative


def _read_extrinsic(file: Path) -> Array:
    """Return a rigid transform, (4, 4); the identity if there is no file."""
    matrix = _read_matrix(file, (4,)) if file.is_file() else np.eye(4)
    rotation = matrix[:3, :3]
    is_transform = np.isfinite(matrix).all() and np.allclose(matrix[3], [0, 0, 0, 1])
    nearest, deviation = nearest_rotation(rotation) if is_transform else (rotation, np.inf)
    if deviation > LARGEST_DEVIATION:
        values = f"{matrix.round(4).tolist()}"
        raise CaptureError(
            f"{file}: wanted a rotation and a translation, 4 x 4, got {values}; export the "
            f"calibration again"
        )
    if deviation > ROUNDING:
        matrix[:3, :3] = nearest
    return matrix


def _read_matrix(file: Path, sides: tuple[int, ...]) -> Array:
    values = _read_values(file)
    if values.size not in [side * side for side in sides]:
        shapes = " or ".join(f"{side} x {side}" for side in sides)
        raise CaptureError(
            f"{file}: wanted a matrix of {shapes} numbers, got {values.size} numbers; export it "
            f"again"
        )
    return values.reshape(2 * [round(values.size**0.5)])


def _read_values(file: Path) -> Array:
    return np.array([number for row in _read_rows(file) for number in row], dtype=np.float64)


def _read_rows(file: Path) -> list[list[float]]:
    """Return the numbers in each line, comments aside."""
    try:
        lines = read_plain_text(file).split("\n")
        return [
            row
            for row in parse_numbers(
                "\n".join("" if line.startswith("#") else line for line in lines)
            )
            if row
        ]
    except (OSError, ValueError) as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise CaptureError(
            f"{file}: wanted a text file of numbers, got: {reason:.120}; export it again"
        ) from error


def _read_seven_scenes(path: Path) -> RgbdSequence:
    images = _numbered(path, [file for file in list_images(path) if file.stem.endswith(".color")])
    depths = _numbered(path, sorted(path.glob("frame-*.depth.png")))
    poses = _numbered(path, sorted(path.glob(SEVEN_SCENES)))
    check_rig_size(path, len(images))
    _check_complete(images, depths, path, "depth map")
    _check_complete(images, poses, path, "pose")
    K, note = _stated_K(path, images.values(), SEVEN_SCENES_K, "7-Scenes")
    return RgbdSequence(
        images=images,
        depths=depths,
        poses={number: _read_matrix(poses[number], (4,)) for number in images},
        K=K,
        K_depth=None,
        note=note,
    )


def _read_tum(path: Path) -> RgbdSequence:
    from scipy.spatial.transform import Rotation

    colour, depth = ({_stamp(file): file for file in list_images(path / name)} for name in TUM[:2])
    rows = _read_rows(path / TUM[2])
    if not rows or {len(row) for row in rows} != {8} or not np.isfinite(rows).all():
        raise CaptureError(
            f"{path / TUM[2]}: wanted rows of a time, a place and a quaternion, 8 numbers, got "
            f"others; export it again"
        )
    values = np.array(rows)
    check_rig_size(path, len(colour))
    values = values[values[:, 0].argsort()]
    stamps = {
        "colour": np.array(sorted(colour)),
        "depth": np.array(sorted(depth)),
        "pose": values[:, 0],
    }
    images, depths, poses = {}, {}, {}
    for index, of_depth, of_pose in zip(
        *find_partners(stamps, SAME_INSTANT_S).values(), strict=True
    ):
        row = values[of_pose]
        if row[4:].any():
            images[index], depths[index] = (
                colour[stamps["colour"][index]],
                depth[stamps["depth"][of_depth]],
            )
            poses[index] = rigid(Rotation.from_quat(row[4:]).as_matrix(), row[1:4])
    left = len(colour) - len(images)
    note = (
        f"{left} of {len(colour)} frames omitted: no depth and pose within {SAME_INSTANT_S:g} s"
        if left
        else ""
    )
    K, assumed = _stated_K(path, images.values(), TUM_K, "TUM RGB-D")
    note = "; ".join(filter(None, (note, assumed)))
    return RgbdSequence(
        images=images,
        depths=depths,
        poses=poses,
        K=K,
        K_depth=None,
        metres_per_step=TUM_STEP,
        note=note,
    )


def _stamp(file: Path) -> float:
    try:
        return float(file.stem)
    except ValueError:
        raise CaptureError(
            f"{file}: wanted a time in seconds as the name of this frame, as TUM RGB-D has it; "
            f"rename it"
        ) from None


def _stated_K(
    path: Path, images: Iterable[Path], stated: Array, data_set: str
) -> tuple[tuple[Array, Path], str]:
    """Return the intrinsics in the file next to the frames, or those that the data set states for
    its size, with a note.
    """
    if (path / INTRINSICS).is_file():
        return _read_K(path / INTRINSICS), ""
    size = next((read_picture_header(image).size for image in images), KINECT_SIZE)
    if size != KINECT_SIZE:
        raise CaptureError(
            f"{path}: wanted images of 640 x 480, for which {data_set} states its camera, got "
            f"{size[0]} x {size[1]}; write the intrinsics of this sequence, 3 x 3 in pixels, into "
            f"{INTRINSICS} there"
        )
    K = stated.copy()
    K[:2, 2] += 0.5
    values = ", ".join(f"{value:g}" for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    alternative = (
        f"if another camera filmed this, write its 3 x 3 matrix in pixels into {INTRINSICS}"
    )
    return (
        K,
        path / INTRINSICS,
    ), f"K of {data_set} is taken (fx, fy, cx, cy {values}); {alternative}"
