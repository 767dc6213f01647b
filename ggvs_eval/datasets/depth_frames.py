"""Depth that a sensor measured, as 16-bit PNG files."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.files.images import decode_image, read_encoded
from ggvs_eval.geometry.reproject_depth import reproject_depth

LARGEST_STEP = 65535  # written for unknown depth by some, as 0 by others
ANY_DEPTH = (1e-6, 1e6)  # near and far of cameras that only say where pixels look


@dataclass(frozen=True, eq=False)
class DepthFrames:
    """Depth maps of one camera, a `DepthSource`: each is brought to the grid of the camera's frames.

    Attributes:
        path: folder of PNG files in the order of the numbers in their names, or one PNG file.
        scale_to_units: world units per step of the files, 0.001 for millimetres in a world of metres.
        width: of the camera's frames, pixels.
        height: of the camera's frames, pixels.
        K: intrinsics of the camera's frames, (3, 3); None where both show the same field of view.
        K_depth: intrinsics of the depth maps as they lie on disk, (3, 3); None in the same case.
        depth_to_colour: rigid transform of points in the depth camera's frame to the colour camera's, (4, 4), world units; None
            where the sensor shares the camera's centre and orientation. Needs both intrinsics.

    Reading:
        Nearest value, never a mean: a mean of two depths lies where nothing is. Where sensor and camera are one, each pixel's
        ray is followed through both intrinsics; rays that the sensor does not see are unknown. Where the sensor stands beside
        the camera, its pixels are drawn into the camera's grid (`reproject_depth`): the nearest surface is seen, and what is
        hidden from the sensor is unknown.
    """

    path: Path
    scale_to_units: float
    width: int
    height: int
    K: Array | None = None
    K_depth: Array | None = None
    depth_to_colour: Array | None = None

    @cached_property
    def _images(self) -> ImageFrames:
        return ImageFrames(self.path)

    @property
    def n_frames(self) -> int:
        """Number of depth maps."""
        return self._images.n_frames

    @cached_property
    def digest(self) -> str:
        """Identifies the files and their processing."""
        matrices = [np.zeros(9) if K is None else K.ravel() for K in (self.K, self.K_depth)]
        values = [self.scale_to_units, self.width, self.height, *np.concatenate(matrices)]
        values += [] if self.depth_to_colour is None else self.depth_to_colour.ravel().tolist()
        return digest_values(self._images.digest, *(f"{value:.17g}" for value in values))

    def depths(self, start: int, stop: int) -> Iterator[NDArray[np.float32]]:
        """Read depth of frames start <= t < stop one by one: z in world units, 0 = unknown, float32 (height, width).

        Raises:
            CaptureError: maps that are not there, or a file that is no 16-bit PNG.
        """
        if not 0 <= start <= stop <= self.n_frames:
            raise CaptureError(f"{self.path}: wanted depth maps {start}..{stop - 1}, the folder has {self.n_frames}")
        for file in self._images.files[start:stop]:
            steps = read_depth_png(file)
            yield self._on_grid(np.where(known_depth(steps), steps, np.uint16(0)))

    def _on_grid(self, steps: NDArray[np.uint16]) -> NDArray[np.float32]:
        if self.depth_to_colour is not None:
            return self._reprojected(steps, self.depth_to_colour)
        columns, rows = (self._found_at(axis, steps.shape[1 - axis]) for axis in (0, 1))
        depth = steps[np.clip(rows, 0, steps.shape[0] - 1)][:, np.clip(columns, 0, steps.shape[1] - 1)]  # (height, width)
        seen_columns, seen_rows = (
            (at >= 0) & (at < length) for at, length in ((columns, steps.shape[1]), (rows, steps.shape[0]))
        )
        depth = np.where(seen_rows[:, None] & seen_columns, depth, 0)
        return (depth * self.scale_to_units).astype(np.float32)

    def _reprojected(self, steps: NDArray[np.uint16], depth_to_colour: Array) -> NDArray[np.float32]:
        """Reproject what a sensor beside the camera measured into the camera's image."""
        if self.K is None or self.K_depth is None:
            raise CaptureError(f"{self.path}: a sensor beside its camera wants the intrinsics of both; export them again")
        colour = Camera("colour", self.K, np.eye(4), self.width, self.height, *ANY_DEPTH)
        colour_to_depth = np.asarray(np.linalg.inv(depth_to_colour), np.float64)
        sensor = Camera("depth", self.K_depth, colour_to_depth, steps.shape[1], steps.shape[0], *ANY_DEPTH)
        return reproject_depth(sensor, steps * self.scale_to_units, colour)

    def _found_at(self, axis: int, length_depth_px: int) -> NDArray[np.int64]:
        """In which column (axis 0) or row (axis 1) of the depth map each column or row of the frame looks."""
        length_px = (self.width, self.height)[axis]
        centres = np.arange(length_px) + 0.5
        if self.K is None or self.K_depth is None:
            return np.floor(centres * length_depth_px / length_px).astype(np.int64)
        rays = (centres - self.K[axis, 2]) / self.K[axis, axis]
        return np.floor(rays * self.K_depth[axis, axis] + self.K_depth[axis, 2]).astype(np.int64)


def read_depth_png(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit PNG as it is, (H, W) uint16.

    Raises:
        CaptureError: absent, damaged, no image of one 16-bit channel, or nothing measured in it.
    """
    steps = decode_image(read_encoded(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if steps is None:
        content = f"{path.stat().st_size} bytes that do not decode"
        raise CaptureError(f"{path}: wanted a depth map, got {content}; export this frame again")
    if steps.dtype != np.uint16 or steps.ndim != 2:
        content = f"{steps.dtype} {steps.shape}"
        raise CaptureError(f"{path}: wanted a depth map of one 16-bit channel, got {content}; export it without conversion")
    measured = steps.astype(np.uint16, copy=False)
    if not known_depth(measured).any():
        content = f"nothing but 0 and {LARGEST_STEP}" if steps.any() else "zeros alone"
        raise CaptureError(f"{path}: wanted measured depth, got {content}; leave this frame out or export it again")
    return measured


def known_depth(steps: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Mask of the measured pixels of a depth map: unknown depth is 0 or, in some data sets, the largest value of the type."""
    return (steps > 0) & (steps < LARGEST_STEP)
