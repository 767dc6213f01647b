"""Filming: the frames of one shot, one after another, in a separate process, and their
exact depth.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.options import DemoOptions, SceneName
from ggvs_eval.contrib.worlds.film.raycast import UNITS_PER_METRE, Picture, View
from ggvs_eval.contrib.worlds.film.shots import Shot
from ggvs_eval.contrib.worlds.room.garden import build_garden
from ggvs_eval.contrib.worlds.room.lighting import Instant, LitRoom
from ggvs_eval.contrib.worlds.room.room import build_room
from ggvs_eval.contrib.worlds.room.shading import expose
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import quantise
from ggvs_eval.kernels.portable import blur, cos, product, rotation_about, sin, unit

# A pixel is lost where depth within its 3 x 3 neighbours differs by more than this share.
EDGE = 0.05
# Noise of triangulating sensors is correlated over N pixels.
CORRELATED_PX = 1.0


class DepthWriter:
    """Writes ``depth`` (T, H, W), float32, world units, and ``frames`` (T,), the video frames they
    belong to.

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
        """Keep the depth of a video frame, (H, W), if it was requested."""
        if frame in self._row:
            self._depth[self._row[frame]] = depth

    def __enter__(self) -> "DepthWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self._file.close()


def depth_path(folder: Path, camera: str) -> Path:
    """Return the file of the exact depth of a camera of a demo."""
    return folder / "depth" / f"{camera}.h5"


def read_exact_depth(folder: Path, camera: str, frame: int) -> Array32:
    """Return the exact depth of one video frame of a demo, world units, (H, W)."""
    import h5py

    path = depth_path(folder, camera)
    if not path.is_file():
        raise CaptureError(
            f"{path}: wanted exact depth, got none; film a demo capture with depth_stride > 0"
        )
    with h5py.File(path) as file:
        frames = file["frames"][:].tolist()
        if frame not in frames:
            raise CaptureError(
                f"{path}: wanted frame {frame}, depth is kept of {frames}; change depth_stride"
            )
        return np.asarray(file["depth"][frames.index(frame)])


def misplaced(options: DemoOptions, camera: Camera, image_width: int) -> Camera:
    """Return the true pose of a depth sensor, of the camera it is written down as.

    Args:
        camera: of the sensor, as it should be, at the moment it measures.
        image_width: of the colour images, pixels, in which the offset is given.

    Reading:
        Offset and rotation are one direction and one axis for the whole sequence, as of a sensor
        that is mounted wrongly. A positive offset along x shifts the depth map to the right of the
        image.
    """
    angle, axis = _mounting(options)
    K, pose = camera.K.copy(), camera.world_to_camera.copy()
    shift_px = options.depth_offset_px * camera.width / image_width
    K[:2, 2] += shift_px * np.array([cos(angle), sin(angle)])
    if options.depth_rotation_rad:
        pose[:3] = product(rotation_about(options.depth_rotation_rad, axis), pose[:3])
    return replace(camera, K=K, world_to_camera=pose)


def measured(options: DemoOptions, depth: Array32, number: int) -> Array32:
    """Depth as the sensor gives it, world units of the rig, 0 if it knows none.

    Exact where the options want no noise.

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
    """Return the direction of the offset in the image, radians, and axis of the rotation, unit
    length, (3,).
    """
    rng = np.random.default_rng([options.seed, 13])
    axis = rng.standard_normal(3)
    return float(rng.uniform(0, 2 * np.pi)), unit(axis)


# Kept next to the demo while it is written, then removed: light of the instants, and what layouts
# put together at the end.
PARTS = "parts"
# Which numbers the noise of a camera's frames and of its background picture begin with.
FRAME_NOISE, BACKGROUND_NOISE = 3, 5


class Frame(NamedTuple):
    """One frame of a shot.

    Attributes:
        image: as it goes to the encoder, gain and noise included, RGB uint8 (H, W, 3).
        foreground: share of each pixel that moving things cover, [0, 1], (H, W).
        depth: exact, world units of the rig, of the undistorted image, (H, W).
    """

    image: Image8
    foreground: Array32
    depth: Array32


class Footage:
    """Frames of one shot; nothing is rendered before it is asked for.

    Args:
        options: of the demo.
        shot: camera and instants.
        recall: gives the lit room at a frame number.
    """

    def __init__(self, options: DemoOptions, shot: Shot, recall: Callable[[int], Instant]) -> None:
        self.options = options
        self.shot = shot
        self._recall = recall

    def instant(self, frame: int) -> Instant:
        """Return the lit room as a frame shows it."""
        return self._recall(self.shot.instants[frame])

    def frames(self) -> Iterator[Frame]:
        """Yield all frames in the order of time, one at a time."""
        noise = self._noise(FRAME_NOISE)
        for index in range(len(self.shot.instants)):
            picture = self._render(self.instant(index))
            yield Frame(self._expose(picture, noise), picture.foreground, picture.depth)

    def frames_keeping_depth(self, folder: Path, depth_scale: float = 1.0) -> Iterator[Frame]:
        """Yield all frames; requested depths are written next to the demo, multiplied by a
        scale.
        """
        options, name = self.options, self.shot.camera.name
        with DepthWriter(
            path=depth_path(folder, name),
            frames=options.depth_frames,
            height=options.height,
            width=options.width,
        ) as writer:
            for index, frame in enumerate(self.frames()):
                writer.add(index, frame.depth * np.float32(depth_scale))
                yield frame

    def empty_room(self) -> Frame:
        """Return the room without its moving things."""
        picture = self._view.render(lit_room(self.options.seed, self.options.scene).empty())
        return Frame(
            self._expose(picture, self._noise(BACKGROUND_NOISE)), picture.foreground, picture.depth
        )

    def noted_camera(self) -> Camera:
        """The camera to write down, with LLFF's depth range: the 1st and the 99.9th percentile of
        what its first frame sees.
        """
        depth = self._view.depth(self.instant(0))
        near, far = np.percentile(depth[depth > 0], [1.0, 99.9])
        return replace(self.shot.noted, near=float(near), far=float(far))

    def _render(self, instant: Instant) -> Picture:
        """Render a picture; if the camera moves while exposing, the mean light of its poses, with
        the middle one's depth.
        """
        if not self.shot.poses:
            return self._view.render(instant)
        lights = [self._view_from(pose).light(instant) for pose in self.shot.poses]
        linear, covered = (
            np.asarray(np.mean(values, axis=0), np.float32) for values in zip(*lights, strict=True)
        )
        return Picture(expose(linear), covered, self._view.depth(instant))

    @cached_property
    def _view(self) -> View:
        return self._view_from(self.shot.camera)

    def _view_from(self, camera: Camera) -> View:
        static = lit_room(self.options.seed, self.options.scene).static
        return View(
            static=static,
            camera=camera,
            supersampling=self.options.supersampling,
            lens=self.shot.lens,
        )

    def _noise(self, stream: int) -> np.random.Generator | None:
        return None if self.shot.sensor is None else self.shot.sensor.noise(stream)

    def _expose(self, picture: Picture, noise: np.random.Generator | None) -> Image8:
        if self.shot.sensor is None or noise is None:
            return quantise(picture.image)
        return self.shot.sensor.expose(picture.image, noise)


def lit_room(seed: int, scene: SceneName = "room") -> LitRoom:
    """Light the room or garden of a seed; the last one is kept, as it takes seconds."""
    return _lit_room(seed, scene)


@lru_cache(maxsize=1)
def _lit_room(seed: int, scene: SceneName) -> LitRoom:
    # lru_cache takes lit_room(0) and lit_room(0, "room") for two rooms.
    return LitRoom(build_garden(seed) if scene == "garden" else build_room(seed))


def light_instant(parts: Path, options: DemoOptions, index: int) -> None:
    """Light the room at a frame number, which may be negative, and store it for all cameras."""
    instant = lit_room(options.seed, options.scene).at(index / options.fps)
    np.savez(_light_file(parts, index), static=instant.static_light, moving=instant.moving_light)


@lru_cache(maxsize=32)
def stored_instant(parts: Path, options: DemoOptions, index: int) -> Instant:
    """Return the instant that `light_instant` has stored."""
    with np.load(_light_file(parts, index)) as stored:
        return lit_room(options.seed, options.scene).recall(
            index / options.fps, stored["static"], stored["moving"]
        )


def _light_file(parts: Path, index: int) -> Path:
    return parts / f"light{index:05d}.npz"
