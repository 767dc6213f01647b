"""Exact depth beside the demo's videos: one HDF5 file per camera."""

from dataclasses import replace
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.rig import UNITS_PER_METRE
from ggvs_eval.errors import CaptureError
from ggvs_eval.kernels.portable import blur, cos, product, rotation_about, sin, unit

# A pixel is lost where depth within its 3 x 3 neighbours differs by more than this share.
EDGE = 0.05
# Noise of triangulating sensors is correlated over so many pixels.
CORRELATED_PX = 1.0


class DepthWriter:
    """Writes ``depth`` (T, H, W), float32, world units, and ``frames`` (T,), the video frames they belong to.

    Args:
        path: file to write; nothing is written where no frames are wanted.
        frames: video frames to keep, ascending.
        height: of an image, pixels.
        width: of an image, pixels.
    """

    def __init__(self, path: Path, frames: list[int], height: int, width: int) -> None:
        import h5py

        self._row = {frame: row for row, frame in enumerate(frames)}
        self._file = None
        if frames:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = h5py.File(path, "w", track_order=False)
            self._file.create_dataset("frames", data=np.array(frames, np.int64), track_times=False)
            size = (len(frames), height, width)
            # Not LZF, whose bytes depend on what was compressed before.
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
            self._depth = self._file.create_dataset(
                "depth", size, np.float32, chunks=(1, height, width), track_times=False, **packed
            )

    def add(self, frame: int, depth: Array32) -> None:
        """Keep the depth of a video frame, (H, W), if it is one of those wanted."""
        if frame in self._row:
            self._depth[self._row[frame]] = depth

    def __enter__(self) -> "DepthWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._file is not None:
            self._file.close()


def depth_path(folder: Path, camera: str) -> Path:
    """File of the exact depth of a camera of a demo."""
    return folder / "depth" / f"{camera}.h5"


def read_exact_depth(folder: Path, camera: str, frame: int) -> Array32:
    """Exact depth of one video frame of a demo, world units, (H, W)."""
    import h5py

    path = depth_path(folder, camera)
    if not path.is_file():
        raise CaptureError(f"{path}: no exact depth here; only a demo capture has it, written with depth_stride > 0")
    with h5py.File(path) as file:
        frames = file["frames"][:].tolist()
        if frame not in frames:
            raise CaptureError(f"{path}: wanted frame {frame}, depth is kept of {frames}; change depth_stride")
        return np.asarray(file["depth"][frames.index(frame)])


def misplaced(options: DemoOptions, camera: Camera, image_width: int) -> Camera:
    """Return the true pose of a depth sensor, of the camera it is written down as.

    Args:
        camera: of the sensor, as it should be, at the moment it measures.
        image_width: of the colour images, pixels, in which the offset is given.

    Reading:
        Offset and rotation are one direction and one axis for the whole sequence, as of a sensor that is mounted wrongly. A
        positive offset along x shifts the depth map to the right of the image.
    """
    angle, axis = _mounting(options)
    K, pose = camera.K.copy(), camera.world_to_camera.copy()
    shift_px = options.depth_offset_px * camera.width / image_width
    K[:2, 2] += shift_px * np.array([cos(angle), sin(angle)])
    if options.depth_rotation_rad:
        pose[:3] = product(rotation_about(options.depth_rotation_rad, axis), pose[:3])
    return replace(camera, K=K, world_to_camera=pose)


def measured(options: DemoOptions, depth: Array32, number: int) -> Array32:
    """Depth as the sensor gives it, world units of the rig, 0 where it knows none; exact where the options want no noise.

    Args:
        depth: exact, (H, W).
    """
    if not options.depth_noise:
        return depth
    rng = np.random.default_rng([options.seed, 12, number, *options.recording])
    grain = blur(rng.standard_normal(depth.shape, np.float32), CORRELATED_PX)
    grain /= max(float(grain.std()), 1e-6)
    depth_m = depth / np.float32(UNITS_PER_METRE)
    noisy = depth + grain * depth_m**2 * np.float32(options.depth_noise * UNITS_PER_METRE)
    window = np.ones((3, 3), np.uint8)
    spread = cv2.dilate(depth, window) - cv2.erode(depth, window)
    return np.where((spread <= EDGE * depth) & (noisy > 0), noisy, 0).astype(np.float32)


def _mounting(options: DemoOptions) -> tuple[float, Array]:
    """Direction of the offset in the image, radians, and axis of the rotation, unit length, (3,)."""
    rng = np.random.default_rng([options.seed, 13])
    axis = rng.standard_normal(3)
    return float(rng.uniform(0, 2 * np.pi)), unit(axis)
