"""RGB-D sequences: one moving camera with a depth sensor before a still scene, as ScanNet,
HoloLens, 7-Scenes, TUM.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, rigid
from ggvs_eval.capture import Capture, Extras
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.depth_range import FAR_MARGIN, NEAR_MARGIN
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.rgbd_files import (
    HOLOLENS,
    MARKS,
    SCANNET,
    SEVEN_SCENES,
    TUM,
    RgbdSequence,
    is_sequence,
    read_sequence,
)
from ggvs_eval.datasets.units import METRIC, GivenUnits, choose_units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.files.images import decode_image, read_encoded
from ggvs_eval.files.names import listed
from ggvs_eval.geometry.reproject_depth import reproject_depth
from ggvs_eval.lens import LARGEST_OFFSET, check_K_size

LARGEST_STEP = 65535  # written for unknown depth by some, as 0 by others
ANY_DEPTH = (1e-6, 1e6)  # near and far of cameras that only say where pixels look


@dataclass(frozen=True, eq=False)
class DepthFrames:
    """Depth maps of one camera, a `DepthSource`: each is brought to the grid of the camera's
    frames.

    Attributes:
        path: folder of PNG files in the order of the numbers in their names, or one PNG file.
        scale_to_units: world units per step of the files, 0.001 for millimetres in a world of
            metres.
        width: of the camera's frames, pixels.
        height: of the camera's frames, pixels.
        K: intrinsics of the camera's frames, (3, 3); None if both show the same field of view.
        K_depth: intrinsics of the depth maps as they are on disk, (3, 3); None in the same case.
        depth_to_colour: rigid transform of points in the depth camera's frame to the colour
            camera's, (4, 4), world units; None where the sensor shares the camera's centre and
            orientation. Needs both intrinsics.

    Reading:
        Nearest value, never a mean: a mean of two depths is where no surface is. Where sensor and
        camera are one, each pixel's ray is followed through both intrinsics; rays that the sensor
        does not see are unknown. Where the sensor is next to the camera, its pixels are drawn into
        the camera's grid (`reproject_depth`): the nearest surface is seen, and what is hidden from
        the sensor is unknown.
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
        """Read depth of frames start <= t < stop one by one: z in world units, 0 = unknown, float32
        (height, width).

        Raises:
            CaptureError: maps that are not there, or a file that is no 16-bit PNG.
        """
        if not 0 <= start <= stop <= self.n_frames:
            raise CaptureError(
                f"{self.path}: wanted depth maps {start}..{stop - 1}, the folder has "
                f"{self.n_frames}"
            )
        for file in self._images.files[start:stop]:
            steps = read_depth_png(file)
            yield self._on_grid(np.where(known_depth(steps), steps, np.uint16(0)))

    def _on_grid(self, steps: NDArray[np.uint16]) -> NDArray[np.float32]:
        if self.depth_to_colour is not None:
            return self._reprojected(steps, self.depth_to_colour)
        columns, rows = (self._found_at(axis, steps.shape[1 - axis]) for axis in (0, 1))
        # (height, width)
        depth = steps[np.clip(rows, 0, steps.shape[0] - 1)][
            :, np.clip(columns, 0, steps.shape[1] - 1)
        ]
        seen_columns, seen_rows = (
            (at >= 0) & (at < length)
            for at, length in ((columns, steps.shape[1]), (rows, steps.shape[0]))
        )
        depth = np.where(seen_rows[:, None] & seen_columns, depth, 0)
        return (depth * self.scale_to_units).astype(np.float32)

    def _reprojected(
        self, steps: NDArray[np.uint16], depth_to_colour: Array
    ) -> NDArray[np.float32]:
        """Reproject what a sensor next to the camera measured into the camera's image."""
        if self.K is None or self.K_depth is None:
            raise CaptureError(
                f"{self.path}: wanted the intrinsics of sensor and camera, got one of them; export "
                f"them again"
            )
        colour = Camera("colour", self.K, np.eye(4), self.width, self.height, *ANY_DEPTH)
        colour_to_depth = np.asarray(np.linalg.inv(depth_to_colour), np.float64)
        sensor = Camera(
            "depth", self.K_depth, colour_to_depth, steps.shape[1], steps.shape[0], *ANY_DEPTH
        )
        return reproject_depth(sensor, steps * self.scale_to_units, colour)

    def _found_at(self, axis: int, length_depth_px: int) -> NDArray[np.int64]:
        """In which column (axis 0) or row (axis 1) of the depth map each column or row of the frame
        looks.
        """
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
    steps = decode_image(
        read_encoded(path),
        cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION,
    )
    if steps is None:
        content = f"{path.stat().st_size} bytes that do not decode"
        raise CaptureError(f"{path}: wanted a depth map, got {content}; export this frame again")
    if steps.dtype != np.uint16 or steps.ndim != 2:
        content = f"{steps.dtype} {steps.shape}"
        raise CaptureError(
            f"{path}: wanted a depth map of one 16-bit channel, got {content}; export it without "
            f"conversion"
        )
    depth_map = steps.astype(np.uint16, copy=False)
    if not known_depth(depth_map).any():
        content = f"nothing but 0 and {LARGEST_STEP}" if steps.any() else "zeros alone"
        raise CaptureError(
            f"{path}: wanted measured depth, got {content}; leave this frame out or export it again"
        )
    return depth_map


def known_depth(steps: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Mask of the measured pixels of a depth map: unknown depth is 0 or, in some data sets, the
    largest value of the type.
    """
    return (steps > 0) & (steps < LARGEST_STEP)


SAMPLED_FRAMES = 32  # of which the depth range is taken
# Where depth has another shape than colour, its intrinsics must fit it this well; within the
# stretch it has the same shape.
LEAST_OFFSET, LARGEST_STRETCH = 0.05, 0.02

__all__ = ["MARKS", "load", "refuse"]


def refuse(path: Path) -> str | None:
    """Return the reason why this folder is not an RGB-D sequence, or None if it is one."""
    if is_sequence(path):
        return None
    return (
        f"neither {'/, '.join(SCANNET)}/ nor {', '.join(HOLOLENS)}, {SEVEN_SCENES} or "
        f"{', '.join(TUM)}"
    )


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a sequence; every frame is one camera of a single instant, called by its number in six
    digits, with its depth.

    Args:
        units: world units per metre or a file that says how to measure them; the poses are metric
            when None.

    Raises:
        CaptureError: fewer than two frames with a pose, or a file that is missing or damaged.

    Reading:
        Frames without a finite pose are left out, which the capture's notes say. Pixels are used as
        stored, regardless of any EXIF tag says, since depth maps and poses know of none. Intrinsics
        in files are taken with pixel centres at halves. All cameras have one depth range, 0.8 times
        the smallest 1st and 1.2 times the largest 99th percentile among 32 evenly spaced depth
        maps: long sequences have thousands.
    """
    sequence = read_sequence(path)
    numbers = [number for number, pose in sequence.poses.items() if np.isfinite(pose).all()]
    if len(numbers) < 2:
        raise CaptureError(
            f"{path}: wanted at least 2 frames with a finite pose, got {len(numbers)} of "
            f"{len(sequence.poses)}; track again"
        )
    sources = [ImageFrames(sequence.images[number], as_stored=True) for number in numbers]
    size = _common_size(sequence.images, numbers)
    _check_intrinsics(*sequence.K, size)
    limits, unknown = _depth_range(
        [sequence.depths[number] for number in numbers], sequence.metres_per_step
    )
    _check_depth_size(sequence, numbers, size)
    cameras = [_make_camera(path, number, sequence, size, limits) for number in numbers]
    extras = [Extras(depth=_depth_source(sequence, number, size)) for number in numbers]
    lost = [_name(number) for number in sequence.poses if number not in numbers]
    notes = [f"{listed(lost)} omitted: no finite pose (tracking lost)"] if lost else []
    notes += [f"{unknown:.1%} of the depth unknown: values 0 and {LARGEST_STEP}"] if unknown else []
    notes += [sequence.note] if sequence.note else []
    units_per_metre = choose_units(path, units, cameras, of_data_set=METRIC)
    return assemble_capture(
        path, "rgbd", cameras, sources, units_per_metre, extras=extras, notes=notes
    )


def _common_size(files: Mapping[int, Path], kept: Sequence[int]) -> tuple[int, int]:
    """Return the size of some files, which they share."""
    numbered = tuple(enumerate(files[number] for number in kept))
    return ImageFrames(numbered[0][1].parent, as_stored=True, numbered=numbered).size


def _check_depth_size(
    sequence: RgbdSequence, numbers: Sequence[int], size: tuple[int, int]
) -> None:
    """Depth maps have one size, of the shape of the images or one that their own intrinsics bear
    out.
    """
    depth_size = _common_size(sequence.depths, numbers)
    same_shape = abs(depth_size[0] * size[1] / (depth_size[1] * size[0]) - 1) < LARGEST_STRETCH
    if sequence.K_depth:
        _check_intrinsics(
            *sequence.K_depth, depth_size, LARGEST_OFFSET if same_shape else LEAST_OFFSET
        )
    elif not same_shape:
        image_size, map_size = (f"{width} x {height}" for width, height in (size, depth_size))
        file = sequence.depths[numbers[0]]
        raise CaptureError(
            f"{file}: wanted depth of the shape of its {image_size} image, got {map_size}; export "
            f"it without cropping"
        )


def _check_intrinsics(
    K: Array, file: Path, size: tuple[int, int], largest_offset: float = LARGEST_OFFSET
) -> None:
    """Text files of intrinsics do not say for which size they are.

    Resized images show by the principal point.
    """
    try:
        check_K_size(K, size, is_stated=False)
    except CameraError as error:
        raise CaptureError(f"{file}: {error}") from error
    offsets = [abs(K[axis, 2] - size[axis] / 2) / size[axis] for axis in (0, 1)]
    if max(offsets) > largest_offset:
        place, point = (
            f"a principal point near the middle of {size[0]} x {size[1]} images",
            f"({K[0, 2]:g}, {K[1, 2]:g})",
        )
        raise CaptureError(
            f"{file}: wanted {place}, got {point}; scale the intrinsics as the images were scaled"
        )


def _depth_range(
    files: Sequence[Path], metres_per_step: float
) -> tuple[tuple[float, float], float]:
    """Near and far, metres, and the share of unknown depth where a file writes it in two ways.

    Else 0.
    """
    indices = np.unique(np.linspace(0, len(files) - 1, SAMPLED_FRAMES).round().astype(int))
    maps = [read_depth_png(files[index]) for index in indices]
    depths = [steps[known_depth(steps)] for steps in maps]
    percentiles = [np.percentile(steps, (1, 99)) for steps in depths]
    nearest, farthest = np.min(percentiles, axis=0)[0], np.max(percentiles, axis=0)[1]
    limits = (
        float(NEAR_MARGIN * metres_per_step * nearest),
        float(FAR_MARGIN * metres_per_step * farthest),
    )
    unknown = 1 - sum(map(len, depths)) / sum(steps.size for steps in maps)
    return limits, unknown if any((steps == LARGEST_STEP).any() for steps in maps) else 0.0


def _make_camera(
    path: Path,
    number: int,
    sequence: RgbdSequence,
    size: tuple[int, int],
    limits: tuple[float, float],
) -> Camera:
    camera_to_world = sequence.poses[number]
    if not np.allclose(camera_to_world[3], [0, 0, 0, 1]):
        last_row = f"the last row {camera_to_world[3].tolist()}"
        raise CaptureError(
            f"{path}: wanted a camera-to-world matrix for frame {number}, got {last_row}; export "
            f"the poses again"
        )
    rotation = camera_to_world[:3, :3].T
    try:
        return Camera(
            _name(number),
            sequence.K[0],
            rigid(rotation, -rotation @ camera_to_world[:3, 3]),
            *size,
            *limits,
        )
    except CameraError as error:
        raise CaptureError(f"{path}: pose of frame {number}: {error}") from error


def _depth_source(sequence: RgbdSequence, number: int, size: tuple[int, int]) -> DepthFrames:
    file = sequence.depths[number]
    K, K_depth = (sequence.K[0], sequence.K_depth[0]) if sequence.K_depth else (None, None)
    return DepthFrames(file, sequence.metres_per_step, *size, K, K_depth, sequence.depth_to_colour)


def _name(number: int) -> str:
    return f"{number:06d}"


LAYOUT = DatasetSpec(
    describe="color/, depth/, pose/ and intrinsic/ (ScanNet), images/, depth/, poses.txt, or "
    "frames of 7-Scenes or TUM",
    refuse=refuse,
    load=load,
    marks=MARKS,
)
