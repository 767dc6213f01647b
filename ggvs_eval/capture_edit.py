"""Capture perturbations: one instant held still, and added sensor noise.

With an instant held still nothing moves, so that any motion in a rendering of it is the method's
flicker.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import Capture, CaptureEdit, DepthSource, Extras, FrameSource
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.files.images import round_levels


@dataclass(frozen=True)
class NoisyFrames:
    """Frames of one camera with new noise at each instant, a `FrameSource`.

    Attributes:
        source: the frames without.
        camera_name: whose they are; every camera has its own noise.
        sigma_255: standard deviation, of 255 levels.
        seed: of the noise; with camera and frame number it decides every bit, regardless of the
            order of requests.
    """

    source: FrameSource
    camera_name: str
    sigma_255: float
    seed: int

    @property
    def n_frames(self) -> int:
        """Number of frames that can be read."""
        return self.source.n_frames

    @property
    def digest(self) -> str:
        """Identifies the content."""
        return digest_values(
            self.source.digest, "noise", self.camera_name, repr(self.sigma_255), str(self.seed)
        )

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Yield the frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""
        for frame, image in enumerate(self.source.frames(start, stop), start):
            yield self._expose(image, frame)

    def _expose(self, image: Image8, frame: int) -> Image8:
        camera = int.from_bytes(hashlib.sha256(self.camera_name.encode()).digest()[:8])
        grain = np.random.default_rng([self.seed, camera, frame]).standard_normal(
            image.shape, np.float32
        )
        return round_levels(image + np.float32(self.sigma_255) * grain)


@dataclass(frozen=True)
class PickedFrames:
    """Frames of one camera at some instants, a `FrameSource`, and a `DepthSource` where its source
    is one.

    Attributes:
        source: all frames, or all depth.
        indices: of the source, ascending; one that repeats is read once.
    """

    source: Any
    indices: tuple[int, ...]

    @property
    def n_frames(self) -> int:
        """Number of instants."""
        return len(self.indices)

    @property
    def digest(self) -> str:
        """Identifies the content."""
        return digest_values(self.source.digest, "picked", *map(str, self.indices))

    def frames(self, start: int, stop: int) -> Iterator[NDArray[Any]]:
        """Yield frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""
        return self._pick(self.source.frames, start, stop)

    def depths(self, start: int, stop: int) -> Iterator[NDArray[Any]]:
        """Yield the depth of frames start <= t < stop one by one."""
        return self._pick(self.source.depths, start, stop)

    def _pick(
        self, read: Callable[[int, int], Iterator[NDArray[Any]]], start: int, stop: int
    ) -> Iterator[NDArray[Any]]:
        indices = self.indices[start:stop]
        if not indices:
            return
        last = indices[0]
        values = read(last, indices[-1] + 1)
        value = next(values)
        for index in indices:
            while last < index:
                value, last = next(values), last + 1
            yield value.copy()


def perturb_capture(capture: Capture, edit: CaptureEdit) -> Capture:
    """Return the same cameras with their frames as wanted, the frames that serve as truth included.

    Args:
        edit: what is done to it; nothing with the defaults.

    Reading:
        Noise falls on the pixels that the capture yields, before the protocol resizes them:
        averaging four pixels to one halves it. It is the same at every brightness, rounded and
        clipped to 8 bit. Backgrounds, masks and measured depth get none.
    """
    _check(capture, edit)
    if edit == CaptureEdit():
        return capture
    named = zip(capture.camera_names, capture.sources, strict=True)
    instants = (edit.hold_frame,) * edit.hold_frames or tuple(range(capture.n_frames))
    return replace(
        capture,
        sources=tuple(_noisy(name, picked(source, instants), edit) for name, source in named),
        extras=tuple(picked_extras(extras, instants) for extras in capture.extras),
        n_frames=edit.hold_frames or capture.n_frames,
        edit=edit,
        notes=(*capture.notes, _describe(edit)),
    )


def _check(capture: Capture, edit: CaptureEdit) -> None:
    senseless = [
        f"{name} {value:g}" for name, value in asdict(edit).items() if not 0 <= value < np.inf
    ]
    if senseless:
        raise CaptureError(
            f"{capture.path}: wanted numbers of at least 0 to hold frames and add noise, got "
            f"{', '.join(senseless)}"
        )
    if edit.hold_frame >= capture.n_frames:
        raise CaptureError(
            f"{capture.path}: wanted frame {edit.hold_frame} held still, the capture has "
            f"{capture.n_frames}"
        )
    if edit.hold_frame and not edit.hold_frames:
        raise CaptureError(
            f"{capture.path}: wanted hold_frames with hold_frame {edit.hold_frame}, got 0; give "
            f"hold_frames"
        )
    if capture.edit is not None:
        raise CaptureError(
            f"{capture.path}: wanted an unmodified capture, got one with held frames or noise; "
            f"open it again"
        )


def _noisy(name: str, source: FrameSource, edit: CaptureEdit) -> FrameSource:
    return (
        NoisyFrames(
            source=source, camera_name=name, sigma_255=edit.sensor_noise_255, seed=edit.noise_seed
        )
        if edit.sensor_noise_255
        else source
    )


def picked(source: FrameSource | DepthSource, indices: tuple[int, ...]) -> Any:
    """Return a source at some instants; the source itself if these are all."""
    return source if indices == tuple(range(source.n_frames)) else PickedFrames(source, indices)


def picked_extras(extras: Extras, indices: tuple[int, ...]) -> Extras:
    """Return masks and depth at some instants, and the background."""
    mask, depth = extras.mask, extras.depth
    return replace(
        extras, mask=mask and picked(mask, indices), depth=depth and picked(depth, indices)
    )


def _describe(edit: CaptureEdit) -> str:
    parts = (
        [f"frame {edit.hold_frame} held still for {edit.hold_frames} instants"]
        if edit.hold_frames
        else []
    )
    if edit.sensor_noise_255:
        parts.append(
            f"sensor noise of {edit.sensor_noise_255:g}/255 added to every camera (seed "
            f"{edit.noise_seed})"
        )
    return ", ".join(parts)
