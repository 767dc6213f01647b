"""A multi-view video capture: cameras and lazily decoded frames, whatever lies on disk."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.errors import CaptureError
from ggvs_eval.images import Image8, ResizeFilter, resize


class FrameSource(Protocol):
    """The frames of one camera as they lie on disk: a video file, a folder of images, a single image."""

    @property
    def n_frames(self) -> int:
        """Number of frames that can be read."""

    @property
    def digest(self) -> str:
        """Identifies the content (names, sizes, bytes), so that results can be tied to their input."""

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Decode frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""


@dataclass(frozen=True)
class Capture:
    """Synchronised fixed cameras that look at one dynamic scene.

    Attributes:
        scene: name of the scene, e.g. ``flame_steak``.
        layout: which adapter read it, e.g. ``dynerf``.
        path: folder on disk.
        cameras: calibrated cameras in the order of the capture.
        sources: frames of each camera, same order.
        n_frames: frames that every camera has.
        fps: frames per second; 0 where the capture is a single instant.
        units_per_metre: world units per metre; metric constants of the method are multiplied by it.
        units_origin: where that number comes from, for the report.
        resize_filter: how frames are resampled when the cameras are resized.
    """

    scene: str
    layout: str
    path: Path
    cameras: tuple[Camera, ...]
    sources: tuple[FrameSource, ...]
    n_frames: int
    fps: float
    units_per_metre: float
    units_origin: str
    resize_filter: ResizeFilter = "lanczos"

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names in the order of the capture."""
        return tuple(camera.name for camera in self.cameras)

    def camera(self, name: str) -> Camera:
        """The camera of that name.

        Raises:
            CaptureError: no such camera.
        """
        return self.cameras[self._index(name)]

    def frames(self, name: str, start: int = 0, stop: int | None = None) -> Iterator[Image8]:
        """Decode frames start <= t < stop of one camera, one at a time, at the size of that camera.

        Args:
            name: camera name.
            start: first frame.
            stop: one past the last frame; all frames when None.

        Yields:
            RGB uint8 images, (camera.height, camera.width, 3).

        Raises:
            CaptureError: unknown camera, or frames that the capture does not have.
        """
        index = self._index(name)
        stop = self.n_frames if stop is None else stop
        if not 0 <= start <= stop <= self.n_frames:
            raise CaptureError(f"{self.path}: wanted frames {start}..{stop - 1} of {name}, the capture has {self.n_frames}")
        width, height = self.cameras[index].size
        for image in self.sources[index].frames(start, stop):
            yield resize(image, width, height, self.resize_filter)

    def frame(self, name: str, index: int) -> Image8:
        """One frame of one camera; to walk through a video use `frames`, which decodes nothing twice."""
        return next(self.frames(name, index, index + 1))

    def digest(self, name: str) -> str:
        """Identifies the content of one camera's frames."""
        return self.sources[self._index(name)].digest

    def resized(self, width: int, height: int, resize_filter: ResizeFilter) -> "Capture":
        """The same capture with every camera and frame at width x height."""
        cameras = tuple(camera.resized(width, height) for camera in self.cameras)
        return replace(self, cameras=cameras, resize_filter=resize_filter)

    def without(self, names: Sequence[str]) -> "Capture":
        """The same capture lacking some cameras."""
        kept = [index for index, camera in enumerate(self.cameras) if camera.name not in names]
        return replace(
            self,
            cameras=tuple(self.cameras[index] for index in kept),
            sources=tuple(self.sources[index] for index in kept),
        )

    def _index(self, name: str) -> int:
        if name not in self.camera_names:
            raise CaptureError(f"{self.path}: no camera {name!r}; the capture has {', '.join(self.camera_names)}")
        return self.camera_names.index(name)


def guess_units_per_metre(cameras: Sequence[Camera], median_depths: Sequence[float] | None = None) -> float:
    """World units per metre where nothing better is known: the median depth of the scene is taken for 2 metres.

    Args:
        cameras: the rig.
        median_depths: median scene depth per camera in world units; the geometric mean of near and far where absent.

    Reading:
        The paper's constants are metres and its COLMAP captures are not; method.md 3.2 resolves it by the ratio of ScanNet,
        tau / median depth = 0.01. On the one rig with a known scale this gives 7.3 units per metre for 10.5 true ones.
    """
    depths = median_depths or [float(np.sqrt(camera.near * camera.far)) for camera in cameras]
    return float(np.median(depths)) / 2.0
