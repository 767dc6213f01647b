"""A multi-view video capture: cameras and lazily decoded frames, in one form for every layout."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import ResizeFilter, resize

PRECISE_PX = 0.5  # median epipolar error up to which cameras are as good as features tell


class FrameSource(Protocol):
    """Stored frames of one camera: a video file, a folder of images, a single image."""

    @property
    def n_frames(self) -> int:
        """Number of frames that can be read."""

    @property
    def digest(self) -> str:
        """Identifies the content (names, sizes, bytes), so that results can be tied to
        their input.
        """

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Decode frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""


def source_chain(source: FrameSource) -> Iterator[FrameSource]:
    """Give a source and those that it takes its frames from, one behind the other, the files on
    disk last.
    """
    inner: FrameSource | None = source
    while inner is not None:
        yield inner
        inner = getattr(inner, "source", None)


class DepthSource(Protocol):
    """Sensor depth that belongs to the frames of one camera."""

    @property
    def n_frames(self) -> int:
        """Number of depth maps."""

    @property
    def digest(self) -> str:
        """Identifies the content."""

    def depths(self, start: int, stop: int) -> Iterator[NDArray[np.float32]]:
        """Read depth of frames start <= t < stop one by one: z in world units, 0 = unknown, float32
        (H, W) like the frames.
        """


@dataclass(frozen=True)
class Extras:
    """Data that some captures hold of a camera besides its frames; None where absent.

    Attributes:
        background: the scene without what moves, one frame.
        mask: where the foreground is, white on black, one per frame.
        depth: measured depth, one per frame.
    """

    background: FrameSource | None = None
    mask: FrameSource | None = None
    depth: DepthSource | None = None


@dataclass(frozen=True)
class CaptureEdit:
    """Changes to a capture as it is read; `ggvs_eval.capture_edit.perturb_capture` makes them.

    Attributes:
        hold_frames: number of instants for which one is held still; 0 lets time continue as it did.
        hold_frame: which one is held still.
        sensor_noise_255: standard deviation of noise on every camera and instant, truth included,
            of 255 levels.
    """

    hold_frames: int = 0
    hold_frame: int = 0
    sensor_noise_255: float = 0.0
    noise_seed: int = 0


@dataclass(frozen=True)
class GivenDepth:
    """Depth maps of another program that take the place of stereo.

    Attributes:
        folder: where they are.
        scale: world units per unit of the files; 0 if it is fitted to points that neighbours share.
        is_distance: they hold lengths of rays, not z.
    """

    folder: str
    scale: float = 0.0
    is_distance: bool = False


@dataclass(frozen=True)
class Calibration:
    """What is known of the cameras of a capture, and which of two calibrations is used.

    Attributes:
        choice: ``given``, ``refined`` or ``compare``.
        cameras: those in use, ``given`` or ``refined``.
        given_px: median epipolar error of near cameras as given, pixels of the pictures that
            features are found in; None if too few match.
        refined_px: the same of refined cameras; None if none were found, as all the below.
        n_points: that they were refined by.
        psnr_db: of source cameras rendered from each other with given and with refined cameras;
            empty if not compared.
        failure: why they could not be refined or compared; empty if they could.
    """

    choice: str
    cameras: str
    given_px: float | None
    refined_px: float | None = None
    n_points: int | None = None
    psnr_db: Sequence[float] = ()
    failure: str = ""

    @property
    def is_precise(self) -> bool:
        """True if the given cameras agree with the pictures."""
        return self.given_px is not None and self.given_px <= PRECISE_PX

    @property
    def limits_methods(self) -> bool:
        """True if given cameras are in use that contradict the pictures, and none that render
        better are known.
        """
        is_compared = self.cameras == "refined" or len(self.psnr_db) > 0
        return not is_compared and self.given_px is not None and self.given_px > PRECISE_PX

    def describe(self) -> str:
        """Return in words which cameras are used, and why."""
        words = (
            f"{self.cameras} cameras are used; median epipolar error {_pixels(self.given_px)} "
            f"as given"
        )
        if self.n_points:
            words += f", {_pixels(self.refined_px)} refined by {self.n_points} points"
        if self.psnr_db:
            words += "; PSNR of source cameras {:.2f} dB as given, {:.2f} dB refined".format(
                *self.psnr_db
            )
        if self.failure:
            words += f"; not compared: {self.failure}"
        is_skipped = self.choice == "compare" and self.is_precise
        return words + (
            f": at most {PRECISE_PX} px, refined ones are not tried" if is_skipped else ""
        )


def _pixels(error_px: float | None) -> str:
    return "unknown" if error_px is None else f"{error_px:.2f} px"


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
        fps: frames per second; 0 if the capture is a single instant, held still or not.
        units_per_metre: world units per metre; metric constants of the method are multiplied by it.
        units_origin: where that number comes from, for the report.
        resize_filter: how frames are resampled when the cameras are resized.
        extras: background, masks and sensor depth of each camera, same order; empty if the capture
            has none of them.
        notes: what was left out and why, for people.
        edit: what was done to the frames; None if they are as they were taken.
        test_views: cameras that its authors hold out; none if it does not say.
        given_depth: where its depth comes from, if it is another program's.
        calibration: what is known of its cameras, where that was asked for.
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
    extras: tuple[Extras, ...] = ()
    notes: tuple[str, ...] = ()
    edit: CaptureEdit | None = None
    test_views: tuple[str, ...] = ()
    given_depth: GivenDepth | None = None
    calibration: Calibration | None = None

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names in the order of the capture."""
        return tuple(camera.name for camera in self.cameras)

    def camera(self, name: str) -> Camera:
        """Return the camera of that name.

        Raises:
            CaptureError: no such camera.
        """
        return self.cameras[self._index(name)]

    def frames(self, name: str, start: int = 0, stop: int | None = None) -> Iterator[Image8]:
        """Decode frames start <= t < stop of one camera, one at a time, at the size of that camera.

        Args:
            stop: one past the last frame; all frames when None.

        Yields:
            RGB uint8 images, (camera.height, camera.width, 3).

        Raises:
            CaptureError: unknown camera, or frames that the capture does not have.
        """
        index = self._index(name)
        stop = self.n_frames if stop is None else stop
        if not 0 <= start <= stop <= self.n_frames:
            raise CaptureError(
                f"{self.path}: wanted frames {start}..{stop - 1} of {name}, the capture has "
                f"{self.n_frames}"
            )
        width, height = self.cameras[index].size
        for image in self.sources[index].frames(start, stop):
            yield resize(image, width, height, self.resize_filter)

    def frame(self, name: str, index: int) -> Image8:
        """Return one frame of one camera.

        To walk through a video use `frames`, which decodes nothing twice.
        """
        return next(self.frames(name, index, index + 1))

    def extras_of(self, name: str) -> Extras:
        """Background, masks and sensor depth of one camera as stored, at their own sizes."""
        index = self._index(name)
        return self.extras[index] if self.extras else Extras()

    @property
    def sensed_cameras(self) -> frozenset[str]:
        """Names of the cameras whose depth a sensor measured."""
        return frozenset(
            name for name in self.camera_names if self.extras_of(name).depth is not None
        )

    def background(self, name: str) -> Image8 | None:
        """Return the static background of one camera at the size of that camera, (H, W, 3).

        None if the capture has none.
        """
        source = self.extras_of(name).background
        if source is None:
            return None
        return resize(next(source.frames(0, 1)), *self.camera(name).size, self.resize_filter)

    def source(self, name: str) -> FrameSource:
        """Stored frames of one camera."""
        return self.sources[self._index(name)]

    def digest(self, name: str) -> str:
        """Identifies the content of one camera's frames."""
        return self.source(name).digest

    def resized(self, width: int, height: int, resize_filter: ResizeFilter) -> "Capture":
        """Return the same capture with every camera and frame at width x height."""
        cameras = tuple(camera.resized(width, height) for camera in self.cameras)
        return replace(self, cameras=cameras, resize_filter=resize_filter)

    def without(self, names: Sequence[str], reason: str) -> "Capture":
        """Return the same capture lacking some cameras.

        The reason becomes a note if there are any.
        """
        if not set(names) & set(self.camera_names):
            return self
        indices = [index for index, camera in enumerate(self.cameras) if camera.name not in names]
        return replace(
            self,
            cameras=tuple(self.cameras[index] for index in indices),
            sources=tuple(self.sources[index] for index in indices),
            extras=tuple(self.extras[index] for index in indices) if self.extras else (),
            notes=(*self.notes, f"{', '.join(names)} left out: {reason}"),
            test_views=tuple(name for name in self.test_views if name not in names),
        )

    def noted(self, note: str) -> "Capture":
        """Return the same capture with one more note."""
        return replace(self, notes=(*self.notes, note))

    def _index(self, name: str) -> int:
        if name not in self.camera_names:
            raise CaptureError(
                f"{self.path}: no camera {name!r}; the capture has {', '.join(self.camera_names)}"
            )
        return self.camera_names.index(name)
