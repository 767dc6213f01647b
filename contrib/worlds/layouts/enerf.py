"""ENeRF-Outdoor's layout (EasyMocap): distorted JPEG, masks, backgrounds, bounds of what moves.

World units are metres.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import PARTS, Footage, Frame, lit_room
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import (
    UNITS_PER_METRE,
    Coefficients,
    in_metres,
    room_to_world,
)
from ggvs_eval.contrib.worlds.film.shots import distorted_shots
from ggvs_eval.contrib.worlds.layouts.pictures import write_grey_png, write_jpeg
from ggvs_eval.contrib.worlds.room.lighting import Geometry
from ggvs_eval.kernels.portable import rotation_vector
from ggvs_eval.lens import Lens

BACKGROUND_POINTS = 20_000
MASKED_SHARE = 0.5
POINT = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])


def write_enerf(folder: Path, footage: Footage) -> Camera:
    """Write images, masks, background and exact depth of one camera.

    Gives the camera to note, metres.

    Reading:
        Masks and background are distorted like the images; the depth is that of the undistorted
        images, metres.
    """
    name = easymocap_name(footage.shot.camera)
    for index, frame in enumerate(footage.frames_keeping_depth(folder, 1 / UNITS_PER_METRE)):
        write_jpeg(folder / "images" / name / f"{index:06d}.jpg", frame.image)
        mask = np.where(frame.foreground >= MASKED_SHARE, 255, 0).astype(np.uint8)
        write_grey_png(folder / "mask" / name / f"{index:06d}.png", mask)
    empty = footage.empty_room()
    write_jpeg(folder / "bkgd" / f"{name}.jpg", empty.image)
    np.save(folder / PARTS / f"points{name}.npy", _background_points(footage, empty))
    return in_metres(footage.noted_camera())


def finish_enerf(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``intri.yml``, ``extri.yml``, ``vhull/`` and ``background.ply``."""
    _write_calibration(folder, cameras, [shot.lens for shot in distorted_shots(options)])
    (folder / "vhull").mkdir()
    for index in range(options.n_frames):
        np.save(folder / "vhull" / f"{index:06d}.npy", moving_bounds(options, index))
    parts = [np.load(folder / PARTS / f"points{easymocap_name(camera)}.npy") for camera in cameras]
    write_ply(folder / "background.ply", parts)


def _write_calibration(
    folder: Path, cameras: Sequence[Camera], lenses: Sequence[Coefficients]
) -> None:
    """Write ``intri.yml`` and ``extri.yml``.

    Reading:
        The matrices are OpenCV's, so the principal point is written half a pixel less, counted from
        the first pixel's centre.
    """
    names = [easymocap_name(camera) for camera in cameras]
    intrinsics, extrinsics = [names_entry("names", names)], [names_entry("names", names)]
    for name, camera, lens in zip(names, cameras, lenses, strict=True):
        intrinsics += [
            matrix_entry(f"K_{name}", camera.K_opencv),
            matrix_entry(f"dist_{name}", np.array(lens)[:, None]),
        ]
        intrinsics += [
            number_entry(f"H_{name}", camera.height),
            number_entry(f"W_{name}", camera.width),
        ]
        vector = rotation_vector(camera.rotation)[:, None]
        extrinsics += [
            matrix_entry(f"R_{name}", vector),
            matrix_entry(f"Rot_{name}", camera.rotation),
        ]
        extrinsics += [matrix_entry(f"T_{name}", camera.translation[:, None])]
    write_yaml(folder / "intri.yml", intrinsics)
    write_yaml(folder / "extri.yml", extrinsics)


def easymocap_name(camera: Camera) -> str:
    """``00`` for cam00."""
    return camera.name.removeprefix("cam")


def moving_bounds(options: DemoOptions, index: int) -> Array:
    """Lowest and highest corner of all that moves at a frame number, world metres, (2, 3)."""
    moving = Geometry(lit_room(options.seed, options.scene).room.at(index / options.fps))
    points_m = room_to_world(moving.vertices) / UNITS_PER_METRE
    return np.stack([points_m.min(axis=0), points_m.max(axis=0)])


def _background_points(footage: Footage, empty: Frame) -> NDArray[np.void]:
    """This camera's share of the background's points: what some of its pixels see, coloured as they
    are.
    """
    camera, options = footage.shot.camera, footage.options
    count = min(BACKGROUND_POINTS // len(options.camera_names), empty.depth.size)
    rng = np.random.default_rng([options.seed, 9, int(easymocap_name(camera))])
    pixels = np.sort(rng.choice(empty.depth.size, count, replace=False))
    uv = camera.pixel_centres().reshape(-1, 2)[pixels]
    points = np.empty(count, POINT)
    points["xyz"] = (
        camera.unproject(uv, empty.depth.ravel()[pixels].astype(np.float64)) / UNITS_PER_METRE
    )
    points["rgb"] = _colours(empty.image, camera, footage.shot.lens, uv)
    return points


def _colours(image: Image8, camera: Camera, lens: Sequence[float], uv: Array) -> Image8:
    """Return the colour of undistorted positions, (N, 2), where the lens puts them in its image,
    (N, 3).
    """
    distorted = Lens(camera.K, "opencv", tuple(lens), *camera.size).distort(uv, camera.K)
    column, row = np.floor(distorted).astype(int).T
    return np.asarray(
        image[np.clip(row, 0, camera.height - 1), np.clip(column, 0, camera.width - 1)]
    )


def write_ply(path: Path, parts: Sequence[NDArray[np.void]]) -> None:
    """Write coloured points as binary PLY."""
    points = np.concatenate(parts)
    kinds = [("float", "x y z"), ("uchar", "red green blue")]
    properties = [f"property {kind} {name}\n" for kind, names in kinds for name in names.split()]
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex "
        f"{len(points)}\n{''.join(properties)}end_header\n"
    )
    path.write_bytes(head.encode() + points.tobytes())


def enerf_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    names = [name.removeprefix("cam") for name in options.camera_names]
    frames = range(options.n_frames)
    images = [
        f"{folder}/{index:06d}.{kind}"
        for name in names
        for folder, kind in _folders(name)
        for index in frames
    ]
    vhull = [f"vhull/{index:06d}.npy" for index in frames]
    return [
        "intri.yml",
        "extri.yml",
        "background.ply",
        *(f"bkgd/{name}.jpg" for name in names),
        *images,
        *vhull,
    ]


def _folders(name: str) -> list[tuple[str, str]]:
    return [(f"images/{name}", "jpg"), (f"mask/{name}", "png")]


def names_entry(key: str, names: Sequence[str]) -> str:
    """Return a sequence of strings."""
    return "\n".join([f"{key}:", *(f'   - "{name}"' for name in names)])


def number_entry(key: str, value: int) -> str:
    """Return a whole number."""
    return f"{key}: {value}"


def matrix_entry(key: str, matrix: Array) -> str:
    """Return a matrix of doubles, every digit of it."""
    data = ", ".join(repr(float(value)) for value in matrix.ravel())
    rows, columns = matrix.shape
    return (
        f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ "
        f"{data} ]"
    )


def write_yaml(path: Path, entries: Sequence[str]) -> None:
    """Write a file that ``cv2.FileStorage`` opens."""
    path.write_text("\n".join(["%YAML:1.0", "---", *entries, ""]), encoding="utf-8")
