"""Depth maps of another program: files of several kinds, and the depth of one camera made
of them.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.errors import CaptureError, GgvsError
from ggvs_eval.files.digest import digest_files, digest_values
from ggvs_eval.files.names import numbers_in
from ggvs_eval.files.plain import check_plain
from ggvs_eval.pipelines.offline.export.dense_workspace import read_array

ENDINGS = (".npy", ".npz", ".png", ".exr", ".pfm", ".bin")
COLMAP_ENDING = ".geometric.bin"  # of a map in a COLMAP workspace, behind the name of the picture
NAMED = "depth"  # array of an archive that holds several
LARGEST_FILE = 4 << 30  # bytes
Depth = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MapFiles:
    """Depth maps of one camera as another program wrote them, a `DepthSource`.

    Attributes:
        files: one per frame, or one file with a map or a stack of maps (T, H, W).
        camera: whose view they show, at any size.
        scale: world units per unit of the files.
        is_distance: the files hold lengths of rays, not z.
    """

    files: tuple[Path, ...]
    camera: Camera
    scale: float = 1.0
    is_distance: bool = False

    @cached_property
    def n_frames(self) -> int:
        """Number of depth maps."""
        return len(self.files) if len(self.files) > 1 else len(read_stack(self.files[0]))

    @cached_property
    def digest(self) -> str:
        """Identifies the files and what is made of them."""
        return digest_values(digest_files(self.files), f"{self.scale:.17g}", str(self.is_distance))

    def depths(self, start: int, stop: int) -> Iterator[Depth]:
        """Read depth of frames start <= t < stop one by one: z in world units, 0 = unknown, float32
        (h, w).

        Raises:
            CaptureError: maps that are not there or cannot be read.
        """
        if not 0 <= start <= stop <= self.n_frames:
            request = f"wanted depth maps {start}..{stop - 1} of {self.camera.name}"
            raise CaptureError(
                f"{self.files[0].parent}: {request}, got {self.n_frames}; choose other frames or "
                f"add maps"
            )
        stack = read_stack(self.files[0]) if len(self.files) == 1 else None
        for frame in range(start, stop):
            values = read_map(self.files[frame]) if stack is None else stack[frame]
            yield self._as_z(values)

    def _as_z(self, values: NDArray[np.floating]) -> Depth:
        with np.errstate(invalid="ignore"):
            mask = np.isfinite(values) & (values > 0)
        depth = np.where(mask, values, 0) * self.scale
        return (
            depth * z_per_distance(self.camera, depth.shape) if self.is_distance else depth
        ).astype(np.float32)


def z_per_distance(camera: Camera, shape: tuple[int, ...]) -> Array:
    """Z of a point at distance 1 on the ray of each pixel of a map of a camera's view, (h, w)."""
    view = camera.resized(shape[1], shape[0])
    u, v = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    x, y = (u - view.K[0, 2]) / view.K[0, 0], (v - view.K[1, 2]) / view.K[1, 1]
    return 1 / np.sqrt(x * x + y * y + 1)


def find_maps(folder: Path, camera_names: tuple[str, ...]) -> Mapping[str, tuple[Path, ...]]:
    """Files of each camera that has any: ``CAM/FRAME.EXT`` in the order of their numbers, or
    ``CAM.EXT``.

    Raises:
        CaptureError: no folder, no map of any camera, or maps of two kinds for one camera.
    """
    if not folder.is_dir():
        raise CaptureError(f"{folder}: wanted a folder of depth maps, there is none; check --depth")
    maps: dict[str, tuple[Path, ...]] = {}
    for name in camera_names:
        inner = sorted(file for file in (folder / name).glob("*") if file.suffix.lower() in ENDINGS)
        single = sorted(
            {
                *(folder / f"{name}{ending}" for ending in ENDINGS),
                *folder.glob(f"{name}.*{COLMAP_ENDING}"),
            }
        )
        files = [file for file in single if file.is_file()]
        if (inner and files) or len(files) > 1 or len({file.suffix.lower() for file in inner}) > 1:
            kinds = ", ".join(str(file.relative_to(folder)) for file in [*files, *inner[:2]])
            raise CaptureError(
                f"{folder}: wanted one kind of depth maps for {name}, got {kinds}; keep one kind "
                f"in --depth's folder"
            )
        if inner or files:
            maps[name] = _in_order(inner) if inner else tuple(files)
    if not maps:
        names = ", ".join(sorted(entry.name for entry in folder.iterdir())[:6]) or "nothing"
        raise CaptureError(
            f"{folder}: wanted depth as CAM/FRAME.EXT or CAM.EXT of {', '.join(camera_names[:4])} "
            f"... ({', '.join(ENDINGS)}), got {names}; name files after the cameras"
        )
    return maps


def _in_order(files: Sequence[Path]) -> tuple[Path, ...]:
    """Files by the numbers in their names."""
    numbers = numbers_in([file.stem for file in files])
    named = [
        (number, file) for number, file in zip(numbers, files, strict=True) if number is not None
    ]
    if len(files) > 1 and len({number for number, _ in named}) < len(files):
        raise CaptureError(
            f"{files[0].parent}: wanted one depth map per frame number, got {files[0].name} ...; "
            f"number the files"
        )
    return tuple(file for _, file in sorted(named)) if len(files) > 1 else tuple(files)


def read_stack(file: Path) -> NDArray[np.floating]:
    """The maps of a file, (T, H, W); of one with a single map T is 1."""
    values = _read(file)
    return values if values.ndim == 3 else values[None]


def read_map(file: Path) -> NDArray[np.floating]:
    """The map of a file, (H, W)."""
    values = _read(file)
    if values.ndim != 2:
        raise CaptureError(
            f"{file}: wanted one map (H, W), got {values.shape}; write one map per file, or one "
            f"stack per camera"
        )
    return values


def _read(file: Path) -> NDArray[np.floating]:
    """The numbers of a file, (H, W) or (T, H, W)."""
    check_plain(file, LARGEST_FILE)
    try:
        values = _read_by_ending(file)
    except (OSError, ValueError, KeyError, GgvsError) as error:
        raise CaptureError(f"{file}: wanted a depth map, got: {error}; write it again") from error
    if values.ndim == 3 and file.suffix.lower() in (".exr", ".pfm"):
        values = values[..., 0]
    if values.ndim not in (2, 3) or values.size == 0 or not np.issubdtype(values.dtype, np.number):
        raise CaptureError(
            f"{file}: wanted numbers (H, W) or (T, H, W), got {values.dtype} {values.shape}; write "
            f"z of each pixel"
        )
    return np.asarray(values, np.result_type(values.dtype, np.float32))


def _read_by_ending(file: Path) -> NDArray[np.generic]:
    ending = file.suffix.lower()
    if ending == ".npy":
        return np.load(file, mmap_mode="r", allow_pickle=False)
    if ending == ".npz":
        with np.load(file, allow_pickle=False) as archive:
            names = archive.files
            if len(names) != 1 and NAMED not in names:
                raise ValueError(f"arrays {', '.join(names)}, none of them called {NAMED}")
            return np.asarray(archive[NAMED if NAMED in names else names[0]])
    if ending == ".bin":
        return read_array(file)
    # OpenCV asks once, when it reads its first one
    os.environ.setdefault("OPENCV_IO_ENABLE_OPENEXR", "1")
    values = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if values is None:
        raise ValueError("OpenCV cannot decode it")
    if ending == ".png" and (values.dtype != np.uint16 or values.ndim != 2):
        raise ValueError(
            f"{values.dtype} with {1 if values.ndim == 2 else values.shape[2]} channels, not one "
            f"of 16 bit"
        )
    return np.asarray(values)
