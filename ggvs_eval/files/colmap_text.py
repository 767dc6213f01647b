"""COLMAP sparse models of pinhole cameras, written as text files."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera

FILES = ("cameras.txt", "images.txt", "points3D.txt")


class Sightings(NamedTuple):
    """Observations of scene points in the image of one camera.

    Attributes:
        point: index of each point that it sees, (M,).
        uv: where, pixels, (M, 2).
        rgb: colour of the pixel there, uint8 (M, 3).
    """

    point: NDArray[np.int64]
    uv: Array
    rgb: Image8

    def rows(self, mask: NDArray[np.bool_]) -> "Sightings":
        """Some of the sightings."""
        return Sightings(self.point[mask], self.uv[mask], self.rgb[mask])


def write_model(
    folder: Path, cameras: Sequence[Camera], sightings: Sequence[Sightings], points: Array
) -> None:
    """Write cameras, images and points, numbered from 1.

    Args:
        cameras: pinholes; each has an image called after it.
        points: all points, world units, (P, 3); those that no camera sees are left out.

    Reading:
        A point's error is the mean distance in pixels between its sightings and its images in these
        cameras.
    """
    folder.mkdir(parents=True)
    _write(
        folder / FILES[0],
        (_camera_line(number, camera) for number, camera in enumerate(cameras, 1)),
    )
    images = (
        _image_lines(number, *pair)
        for number, pair in enumerate(zip(cameras, sightings, strict=True), 1)
    )
    _write(folder / FILES[1], (line for lines in images for line in lines))
    _write(folder / FILES[2], _point_lines(cameras, sightings, points))


def _camera_line(number: int, camera: Camera) -> str:
    intrinsics = _numbers([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]])
    return f"{number} PINHOLE {camera.width} {camera.height} {intrinsics}"


def _image_lines(number: int, camera: Camera, sightings: Sightings) -> list[str]:
    """Return the pose with name, and the sightings as x, y and number of the point."""
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(camera.rotation).as_quat(canonical=True, scalar_first=True)
    pose = _numbers([*quaternion, *camera.translation])
    sights = (
        f"{_numbers(uv)} {index + 1}"
        for uv, index in zip(sightings.uv, sightings.point, strict=True)
    )
    return [f"{number} {pose} {number} {camera.name}.png", " ".join(sights)]


def _point_lines(
    cameras: Sequence[Camera], sightings: Sequence[Sightings], points: Array
) -> Iterable[str]:
    """Yield the place, colour, error, and the track: number of the image and of the sighting in it,
    from 0.
    """
    tracks: dict[int, list[str]] = {}
    colours: dict[int, list[Image8]] = {}
    errors_px: dict[int, list[float]] = {}
    for number, (camera, sights) in enumerate(zip(cameras, sightings, strict=True), 1):
        missed_px = np.linalg.norm(camera.project(points[sights.point])[0] - sights.uv, axis=1)
        for row, index in enumerate(sights.point.tolist()):
            tracks.setdefault(index, []).append(f"{number} {row}")
            colours.setdefault(index, []).append(sights.rgb[row])
            errors_px.setdefault(index, []).append(float(missed_px[row]))
    for index in sorted(tracks):
        red, green, blue = np.rint(np.mean(colours[index], axis=0)).astype(int)
        place, error_px = _numbers(points[index]), float(np.mean(errors_px[index]))
        yield f"{index + 1} {place} {red} {green} {blue} {error_px!r} {' '.join(tracks[index])}"


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _write(path: Path, lines: Iterable[str]) -> None:
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
