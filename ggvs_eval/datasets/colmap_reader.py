"""The script of the `SideProcess` for COLMAP models: pycolmap, once loaded, breaks the writing of PNG files."""

import os
import tempfile
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from struct import error as StructError
from struct import unpack_from
from typing import Any

import numpy as np

from ggvs_eval.files.plain import check_plain, coding_of, parse_numbers, read_plain_text
from ggvs_eval.side_process import serve

LARGEST_MODEL_FILE = 512 << 20
FILES = ("cameras", "images", "points3D")
PERCENTILES = (1, 50, 99)
LONGEST_ROUNDING = 1e-3  # of a quaternion's length; one farther from 1 was scaled, and is brought to 1
FEWEST_POINTS = 10  # seen from a camera, of which a depth range can be taken


def read_reconstruction(folder: Path) -> list[dict[str, Any]]:
    """Return the registered images of a sparse model in the order of their names.

    Args:
        folder: holds cameras, images and perhaps points3D, as text or binary.

    Returns:
        Per image its ``name``, the camera's ``model``, ``width``, ``height`` and ``params``, ``world_to_camera`` (3 x 4) and
        ``depth_percentiles`` (1, 50, 99) of the points seen, world units; an empty list where it sees too few.

    Raises:
        ValueError: a file is absent, ends early or contradicts another.
        NotPlainError: a file is larger than that of any model.
    """
    import pycolmap

    suffix = ".bin" if (folder / "cameras.bin").is_file() else ".txt"
    files = [folder / f"{name}{suffix}" for name in FILES]
    missing = [file.name for file in files[:2] if not file.is_file()]
    if missing:
        raise ValueError(f"no {', '.join(missing)}")
    files = [file for file in files if os.path.lexists(file)]
    for file in files:
        check_plain(file, LARGEST_MODEL_FILE)
    if suffix == ".bin":
        _check_count(files[0])
        for file, find_end in zip(files[1:], (_images_end, _points_end), strict=False):
            _check_length(file, find_end)
    names = {} if suffix == ".bin" else _read_text_names(*files)
    # These three suffice; rigs and frames, which newer versions add, would only be more files that can be damaged.
    with tempfile.TemporaryDirectory() as alone:
        for file in files:
            _put(file, Path(alone) / file.name)
        rows = {line for line, _ in _image_rows(files[1])} if suffix == ".txt" else set()
        if any(line + 1 in rows for line in rows):  # written without the lines of points, which pycolmap counts on
            lines = read_plain_text(files[1], LARGEST_MODEL_FILE).split("\n")
            for name in {files[1].name, files[-1].name}:  # what points say of rows that are not there makes no sense
                (Path(alone) / name).unlink()
            (Path(alone) / "points3D.txt").write_bytes(b"")
            spaced = [f"\n{text}" if line in rows and line - 1 in rows else text for line, text in enumerate(lines, 1)]
            (Path(alone) / files[1].name).write_text("\n".join([*spaced, "", ""]), encoding="utf-8")
        if len(files) < len(FILES):  # points are for depth ranges alone
            (Path(alone) / f"points3D{suffix}").write_bytes(bytes(8) if suffix == ".bin" else b"")
        reconstruction = pycolmap.Reconstruction(alone)
    if suffix == ".bin":
        end = 8 + sum(24 + 8 * len(camera.params) for camera in reconstruction.cameras.values())
        _check_length(files[0], lambda _: end)
    images = [image for image in reconstruction.images.values() if image.has_pose]
    described = [_describe_image(reconstruction, image, names.get(image.image_id, image.name)) for image in images]
    return sorted(described, key=lambda image: image["name"])


def _describe_image(reconstruction: Any, image: Any, name: str) -> dict[str, Any]:
    import pycolmap

    camera = reconstruction.cameras[image.camera_id]
    pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
    world_to_camera = np.array(pose.matrix())  # (3, 4)
    quaternion = np.asarray(pose.rotation.quat, np.float64)
    length = float(np.linalg.norm(quaternion))
    if length > 0 and abs(length - 1) > LONGEST_ROUNDING:
        world_to_camera[:, :3] = pycolmap.Rotation3d(quaternion / length).matrix()
    points2D = image.points2D if len(reconstruction.points3D) else []  # a model that was stripped of its points still names them
    point_ids = [point.point3D_id for point in points2D if point.has_point3D()]
    points_world = np.array([reconstruction.points3D[point].xyz for point in point_ids]).reshape(-1, 3)
    depth = points_world @ world_to_camera[2, :3] + world_to_camera[2, 3]
    depth = depth[depth > 0]
    return {
        "name": name,
        "model": camera.model.name,
        "width": camera.width,
        "height": camera.height,
        "params": list(camera.params),
        "world_to_camera": world_to_camera.tolist(),
        "quaternion_length": length,
        "depth_percentiles": np.percentile(depth, PERCENTILES).tolist() if len(depth) >= FEWEST_POINTS else [],
    }


def _read_text_names(cameras: Path, images: Path, points: Path | None = None) -> dict[int, str]:
    """The names of a text model's images by number: the rest of the line, of which pycolmap takes what comes before a blank.

    Raises:
        ValueError: a number that is none; pycolmap stops at its comma and says that something is wrong somewhere.
    """
    for line, words in _rows(cameras):
        _check_numbers(cameras, line, words[2:])
    if points:
        for line, words in islice(_rows(points), 1):
            _check_numbers(points, line, words[:8])
    names = {}
    for line, words in _image_rows(images):
        _check_numbers(images, line, words[:9])
        if len(words) < 10:
            raise ValueError(f"{images.name}, line {line}: wanted nine numbers and a name, got {len(words)} words")
        names[int(words[0])] = words[9]
    return names


def _rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and words of each row, comments aside."""
    for line, text in enumerate(read_plain_text(file, LARGEST_MODEL_FILE).split("\n"), 1):
        if text.strip() and not text.lstrip().startswith("#"):
            yield line, text.strip().split(maxsplit=9)


def _image_rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """The rows of images; the line after each is the points that it sees, unless it is the row of an image itself."""
    sees_points = False
    for line, text in enumerate(read_plain_text(file, LARGEST_MODEL_FILE).split("\n"), 1):
        words = text.strip().split(maxsplit=9)
        if sees_points and not _is_image(words):
            sees_points = False
        elif words and not words[0].startswith("#"):
            sees_points = True
            yield line, words


def _is_image(words: list[str]) -> bool:
    """Tell whether a row where points are expected is an image's: nine numbers and a name."""
    try:
        return len(words) == 10 and bool([float(word) for word in words[:9]]) and not words[9].replace(" ", "")[:1].isdecimal()
    except ValueError:
        return False


def _check_numbers(file: Path, line: int, words: list[str]) -> None:
    try:
        parse_numbers(" ".join(words), line)
    except ValueError as error:
        raise ValueError(f"{file.name}, {error}") from None


def _put(file: Path, target: Path) -> None:
    """Link a file of the model; a text with a byte order mark, which pycolmap does not know, is written without it."""
    with file.open("rb") as opened:
        is_marked = file.suffix == ".txt" and coding_of(opened.read(4)) != "utf-8"
    if is_marked:
        target.write_text(read_plain_text(file, LARGEST_MODEL_FILE), encoding="utf-8")
    else:
        target.symlink_to(file.resolve())


def _check_count(file: Path) -> None:
    """Refuse a number of cameras, at least 48 bytes each, that the file cannot hold: pycolmap would count up to it."""
    content = file.read_bytes()
    if len(content) < 8 or 8 + 48 * unpack_from("<Q", content)[0] > len(content):
        raise ValueError(f"{file.name} is cut or damaged, its {len(content)} bytes do not fit its number of cameras")


def _check_length(file: Path, find_end: Callable[[bytes], int]) -> None:
    """Refuse a binary file that is cut: pycolmap reads on past the end and invents the rest, or takes minutes to notice."""
    content = file.read_bytes()
    try:
        whole = find_end(content) == len(content)
    except (StructError, ValueError):
        whole = False
    if not whole:
        raise ValueError(f"{file.name} is cut or damaged, its {len(content)} bytes do not fit its content")


def _images_end(content: bytes) -> int:
    """Walk over the images: 64 bytes of numbers, a name that ends with 0, a count, 24 bytes per point."""
    at = 8
    for _ in range(unpack_from("<Q", content)[0]):
        at = content.index(b"\0", at + 64) + 1
        at += 8 + 24 * unpack_from("<Q", content, at)[0]
    return at


def _points_end(content: bytes) -> int:
    """Walk over the points: 43 bytes of numbers, a count, 8 bytes per observation."""
    at = 8
    for _ in range(unpack_from("<Q", content)[0]):
        at += 51 + 8 * unpack_from("<Q", content, at + 43)[0]
    return at


if __name__ == "__main__":
    serve(read_reconstruction)
