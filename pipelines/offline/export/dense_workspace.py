"""A COLMAP dense workspace of one instant: its `stereo_fusion` and meshers, and anything that reads
their files continue from it.

::

    FOLDER/images/<camera>.png
    FOLDER/sparse/cameras.txt  images.txt  points3D.txt
    FOLDER/stereo/depth_maps/<camera>.png.geometric.bin    normal_maps/...    consistency_graphs/
    FOLDER/stereo/patch-match.cfg  fusion.cfg

Maps are ``width&height&channels&`` in ASCII, then float32, one channel after the other.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.files.atomic import atomic_folder, write_bytes
from ggvs_eval.files.colmap_text import Sightings, write_model
from ggvs_eval.files.images import write_image
from ggvs_eval.geometry.pinhole import as_image, as_image8
from ggvs_eval.pipelines.offline.export.surfaces import LEAST_CONFIDENCE, surface_normals

HEADER = re.compile(rb"(\d{1,9})&(\d{1,9})&(\d{1,9})&")
POINTS_PER_CAMERA = 1000
AGREES = 0.01  # a camera sees a point where its own depth differs by no larger share
# COLMAP reads names up to a blank in images.txt, up to a comma in patch-match.cfg, and a stroke as
# a folder.
TELLING = re.compile(r"[\s,/\\]")


def write_array(path: Path, array: NDArray[np.float32]) -> None:
    """Write a map whole or not at all.

    Args:
        path: the file; its folder is made.
        array: (H, W), or (H, W, C).
    """
    planes = array[None] if array.ndim == 2 else np.moveaxis(array, -1, 0)  # (C, H, W)
    channels, height, width = planes.shape
    write_bytes(
        path,
        f"{width}&{height}&{channels}&".encode() + np.ascontiguousarray(planes, "<f4").tobytes(),
    )


def read_array(path: Path) -> NDArray[np.float32]:
    """Read what `write_array` or COLMAP wrote, (H, W) where it has one channel, else (H, W, C)."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DepthError(
            f"{path}: wanted a map of COLMAP, got: {error}; export the workspace again"
        ) from None
    header = HEADER.match(content)
    if header is None:
        raise DepthError(
            f"{path}: wanted a map that begins with width&height&channels&, got {content[:24]!r}; "
            f"export it again"
        )
    width, height, channels = (int(number) for number in header.groups())
    expected, size = 4 * width * height * channels, len(content) - header.end()
    if expected != size or not expected:
        raise DepthError(
            f"{path}: wanted {width} x {height} x {channels} numbers in {expected} bytes, got "
            f"{size}; the file is cut short or damaged, export it again"
        )
    planes = np.frombuffer(content, "<f4", offset=header.end()).reshape(channels, height, width)
    return np.ascontiguousarray(
        planes[0] if channels == 1 else np.moveaxis(planes, 0, -1), np.float32
    )


def write_dense_workspace(
    cameras: Sequence[Camera],
    images: Sequence[Image8],
    depth_maps: Sequence[DepthMap],
    partners: Mapping[str, Sequence[str]],
    folder: Path,
    points_per_camera: int = POINTS_PER_CAMERA,
) -> Path:
    """Write the workspace whole or not at all.

    Args:
        images: of one instant, RGB uint8 (H, W, 3), in the order of the cameras.
        depth_maps: theirs; every number that is kept is written as it is.
        partners: camera -> the cameras its depth was matched with, for ``patch-match.cfg``; those
            not exported are passed over.
        folder: where to; absent or empty.
        points_per_camera: sparse points taken from each depth map; COLMAP learns from them which
            images overlap.

    Raises:
        DepthError: the folder holds something, sizes do not fit, or a name that COLMAP's text files
            cannot hold.

    Reading:
        COLMAP marks depth that passed its own check between views as geometric. This depth has
        passed one between partners, so it goes by that name, the one that `stereo_fusion` asks for.
        The sparse points are points of the depth maps, each with every camera whose own depth
        agrees; their normals and the normal maps come from planes fitted to the depth.
    """
    _check(cameras, images, depth_maps, folder)
    depths = [
        np.where(depth_map.confidence >= LEAST_CONFIDENCE, depth_map.depth, np.float32(0))
        for depth_map in depth_maps
    ]
    with atomic_folder(folder) as unfinished:
        _write_maps(cameras, images, depths, unfinished)
        points = _surface_points(cameras, depths, points_per_camera)
        write_model(unfinished / "sparse", cameras, *_shared(cameras, images, depths, points))
        _write_lists(cameras, partners, unfinished / "stereo")
    return folder


def _check(
    cameras: Sequence[Camera],
    images: Sequence[Image8],
    depth_maps: Sequence[DepthMap],
    folder: Path,
) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DepthError(
            f"{folder}: wanted a new or empty folder, got one with files; choose another"
        )
    for camera, image, depth_map in zip(cameras, images, depth_maps, strict=True):
        as_image8(image, camera, DepthError)
        as_image(depth_map.depth, camera, "depth", DepthError)
        if TELLING.search(camera.name):
            raise DepthError(
                f"camera {camera.name!r}: wanted a name without blanks, commas and slashes, which "
                "COLMAP's files cannot hold; rename its frames"
            )


def _write_maps(
    cameras: Sequence[Camera], images: Sequence[Image8], depths: Sequence[Map], folder: Path
) -> None:
    for camera, image, depth in zip(cameras, images, depths, strict=True):
        write_image(folder / "images" / _image(camera.name), image)
        for kind, array in (("depth_maps", depth), ("normal_maps", surface_normals(camera, depth))):
            write_array(folder / "stereo" / kind / f"{_image(camera.name)}.geometric.bin", array)


def _write_lists(
    cameras: Sequence[Camera], partners: Mapping[str, Sequence[str]], folder: Path
) -> None:
    """Images to match and to fuse; COLMAP chooses partners itself where none is known."""
    (folder / "consistency_graphs").mkdir(parents=True)
    names = [camera.name for camera in cameras]
    lines = []
    for name in names:
        partner_images = [_image(partner) for partner in partners.get(name, ()) if partner in names]
        lines += [_image(name), ", ".join(partner_images) or "__auto__, 20"]
    (folder / "patch-match.cfg").write_text(
        "".join(f"{line}\n" for line in lines), encoding="utf-8"
    )
    (folder / "fusion.cfg").write_text(
        "".join(f"{_image(name)}\n" for name in names), encoding="utf-8"
    )


def _surface_points(cameras: Sequence[Camera], depths: Sequence[Map], count: int) -> Array:
    """Return the points of the depth maps in the world, evenly strewn over their known pixels, (P,
    3).
    """
    points = [np.zeros((0, 3))]
    for camera, depth in zip(cameras, depths, strict=True):
        valid_pixels = np.flatnonzero(depth)
        pixels = valid_pixels[
            np.linspace(0, len(valid_pixels) - 1, min(count, len(valid_pixels))).astype(np.intp)
        ]
        row, column = np.unravel_index(pixels, depth.shape)
        centres = np.stack([column, row], axis=1).astype(np.float64) + 0.5
        points.append(camera.unproject(centres, depth[row, column].astype(np.float64)))
    return np.concatenate(points)


def _shared(
    cameras: Sequence[Camera], images: Sequence[Image8], depths: Sequence[Map], points: Array
) -> tuple[list[Sightings], Array]:
    """Return each camera's sightings of the points that two cameras or more see, and these
    points.
    """
    sightings = [_sightings(*view, points) for view in zip(cameras, images, depths, strict=True)]
    times = np.bincount(
        np.concatenate([sighting.point for sighting in sightings]), minlength=len(points)
    )
    mask = times >= 2
    renumbered = np.cumsum(mask) - 1
    shared = [sighting.rows(mask[sighting.point]) for sighting in sightings]
    return [sighting._replace(point=renumbered[sighting.point]) for sighting in shared], points[
        mask
    ]


def _sightings(camera: Camera, image: Image8, depth: Map, points: Array) -> Sightings:
    """Return the points that are on a camera's own depth map."""
    uv, z = camera.project(points)
    inside = np.flatnonzero((z > 0) & (uv >= 0).all(axis=1) & (uv < camera.size).all(axis=1))
    column, row = np.floor(uv[inside]).astype(np.intp).T
    agrees: NDArray[np.bool_] = np.abs(depth[row, column] - z[inside]) <= AGREES * z[inside]
    return Sightings(inside[agrees], uv[inside[agrees]], image[row[agrees], column[agrees]])


def _image(name: str) -> str:
    return f"{name}.png"
