"""Sensor depth moved to where its colour is: an offset in the image, a roll, a delay and a scale that all frames share."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, DepthSource
from ggvs_eval.files.digest import digest_values
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.geometry.reproject_depth import reproject_depth
from ggvs_eval.pipelines.offline.sensor.sensor_grid import SensorGrid, SensorLines


@dataclass(frozen=True)
class Registration:
    """Registration of a sensor's depth with its colour; zeros and a scale of 1 leave it as it is.

    Attributes:
        right: depth belongs this far to the right of its place, image widths.
        down: and this far down, image widths.
        roll_rad: and turned by this much about the principal point, from right to down.
        delay_frames: depth was measured this many frames after its colour was taken.
        scale: and must be multiplied by this.
    """

    right: float = 0.0
    down: float = 0.0
    roll_rad: float = 0.0
    delay_frames: float = 0.0
    scale: float = 1.0

    @property
    def moves(self) -> bool:
        """True if the registration shifts depth in the image."""
        return (self.right, self.down, self.roll_rad, self.delay_frames) != (0.0, 0.0, 0.0, 0.0)

    def apply(self, depth: Map, camera: Camera, taken_at: Array) -> Map:
        """Return the depth where it belongs.

        Args:
            depth: z as given, world units, 0 = unknown, (h, w): the camera's view at any size.
            taken_at: world_to_camera when the depth was measured, (4, 4); the camera's own without a delay.

        Returns:
            (h, w): what the camera sees of it, drawn from the sensor's own pixels.
        """
        scaled = depth * np.float32(self.scale)
        if not self.moves:
            return scaled
        view = camera.resized(depth.shape[1], depth.shape[0])
        grid = SensorGrid.find(scaled)
        cosine, sine = np.cos(self.roll_rad), np.sin(self.roll_rad)
        turned_back = np.array([[cosine, sine, 0, 0], [-sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        K = view.K.copy()
        K[:2, 2] -= turned_back[:2, :2] @ (self.right, self.down) * view.width
        K[0], K[1, 1:] = _along(grid.columns, K[0]), _along(grid.rows, K[1])[1:]
        height, width = len(grid.rows.first), len(grid.columns.first)
        sensor = replace(view, K=K, world_to_camera=turned_back @ taken_at, width=width, height=height)
        return reproject_depth(sensor, grid.reduce(scaled), view)

    def describe(self, width_px: int) -> str:
        """In words, for images of some width."""
        parts = [
            f"{self.right * width_px:+.2f} px right, {self.down * width_px:+.2f} px down",
            f"roll {np.degrees(self.roll_rad):+.2f} deg",
            f"delay {self.delay_frames:+.2f} frames" if self.delay_frames else "",
            f"scale {self.scale:.4f}",
        ]
        return ", ".join(part for part in parts if part)


@dataclass(frozen=True, eq=False)
class RegisteredDepth:
    """Depth of a sensor, registered: a `DepthSource`.

    Attributes:
        source: as it was given.
        camera: the colour camera, at any size.
        registration: that aligns it with its colour.
        taken_at: world_to_camera when the depth was measured, (4, 4).
    """

    source: DepthSource
    camera: Camera
    registration: Registration
    taken_at: Array

    @property
    def n_frames(self) -> int:
        """Number of depth maps."""
        return self.source.n_frames

    @property
    def digest(self) -> str:
        """Identifies the given depth and its processing."""
        values = [
            *asdict(self.registration).values(),
            *self.camera.K.ravel(),
            *(self.taken_at - self.camera.world_to_camera).ravel(),
        ]
        return digest_values(self.source.digest, *(f"{value:.17g}" for value in values))

    def depths(self, start: int, stop: int) -> Iterator[Map]:
        """Read depth of frames start <= t < stop one by one, registered, like `DepthSource.depths`."""
        for depth in self.source.depths(start, stop):
            yield self.registration.apply(depth, self.camera, self.taken_at)


def with_registration(capture: Capture, registration: Registration) -> Capture:
    """Return the capture with the depth of every frame registered; as it is if nothing is to be done."""
    if registration == Registration():
        return capture
    extras = []
    for index, camera in enumerate(capture.cameras):
        given = capture.extras_of(camera.name)
        taken_at = pose_after(capture.cameras, index, registration.delay_frames)
        depth = given.depth and RegisteredDepth(given.depth, camera, registration, taken_at)
        extras.append(replace(given, depth=depth))
    return replace(capture, extras=tuple(extras))


def read_depth(capture: Capture, index: int) -> Map:
    """Return the depth of one frame at the size of its camera, the nearest value of each pixel, (H, W)."""
    camera = capture.cameras[index]
    source = capture.extras_of(camera.name).depth
    if source is None:
        return np.zeros((camera.height, camera.width), np.float32)
    depth = next(iter(source.depths(0, 1)))
    at = [((np.arange(n) + 0.5) * m / n).astype(np.intp) for n, m in zip((camera.height, camera.width), depth.shape, strict=True)]
    return depth[np.ix_(*at)]


def pose_after(cameras: tuple[Camera, ...], index: int, frames: float) -> Array:
    """World_to_camera of a moving camera some frames after one of them, (4, 4), by its motion at a constant speed until the next.

    Past the ends of the sequence the last motion continues.
    """
    if not frames or len(cameras) < 2:
        return cameras[index].world_to_camera
    first = int(np.clip(index + np.floor(frames), 0, len(cameras) - 2))
    share = index + frames - first
    motion = rigid_between(cameras[first], cameras[first + 1])
    step = np.eye(4)
    step[:3, :3] = cv2.Rodrigues(share * cv2.Rodrigues(motion[:3, :3])[0])[0]
    step[:3, 3] = share * motion[:3, 3]
    return np.asarray(step @ cameras[first].world_to_camera, np.float64)


def _along(lines: SensorLines, row: Array) -> Array:
    """Return a row of intrinsics on the sensor's pixels, whose size and origin come from a line through their middles."""
    places = np.arange(len(lines.centre)) + 0.5
    pitch, start = np.polyfit(places, lines.centre, 1) if len(places) > 1 else (1.0, 0.0)
    scaled = row / pitch
    scaled[2] = (row[2] - start) / pitch
    return np.asarray(scaled, np.float64)
