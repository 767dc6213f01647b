"""Everything the check wants to know of one camera's frames, gathered while they are decoded once."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import Capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.geometry.features import Features, find_features

# Still fine enough to see an arm move, small enough to cost less than decoding.
LONGEST_SIDE_PX = 480
CELLS_PER_SIDE = 16
# Frames kept as small pictures to compare the cameras' timing; they bound the memory, whatever the capture's length.
BURST_FRAMES, BURST_LONGEST_SIDE_PX = 64, 240
# Pixels looked at singly for noise: averaging would hide it.
NOISE_SAMPLES_PER_SIDE = 200
# After damage, reading goes on 1, 2, 4, ... frames later, this often at most.
RESTARTS = 6


@dataclass(frozen=True)
class Damage:
    """A frame that cannot be read, and the message that names its file."""

    frame: int
    message: str


@dataclass(frozen=True, eq=False)
class CameraRecord:
    """Record of one pass over the frames of a camera.

    Attributes:
        black: frames of which every pixel is 0.
        change: how much each frame differs from the one before it where it differs most, mean of a 16th of the image's sides,
            0..255, (T,); NaN for the first and where either was not read.
        noise_sigma_255: of a single pixel, from differences of consecutive frames; NaN with fewer than two frames.
        burst_start: frame number of the first picture of the burst.
        burst: small grey pictures, uint8 (B, h, w).
        features: of the first frame that was read and is not black; None where there is none.
    """

    name: str
    n_read: int
    damage: tuple[Damage, ...]
    black: tuple[int, ...]
    change: NDArray[np.float32]
    noise_sigma_255: float
    burst_start: int
    burst: NDArray[np.uint8]
    features: Features | None


def record_camera(capture: Capture, name: str) -> CameraRecord:
    """Decode a camera's frames once; what cannot be read is noted and passed over."""
    burst_start = max((capture.n_frames - BURST_FRAMES) // 2, 0)
    change = np.full(capture.n_frames, np.nan, np.float32)
    noise_counts = np.zeros(256, np.int64)
    damage: list[Damage] = []
    burst: list[Image8] = []
    black: list[int] = []
    features: Features | None = None
    last, last_small, last_sparse, n_read = -2, None, None, 0
    for index, image in _readable_frames(capture, name, damage):
        small, sparse = _small_grey(image, LONGEST_SIDE_PX), _sparse(image)
        if index == last + 1 and last_small is not None and last_sparse is not None:
            change[index] = largest_change(small, last_small)
            noise_counts += np.bincount(cv2.absdiff(sparse, last_sparse).ravel(), minlength=256)
        if not image.any():
            black.append(index)
        elif features is None:
            features = find_features(image)
        # A burst with a gap would shift what follows, so it ends there.
        if index == burst_start + len(burst) and len(burst) < BURST_FRAMES:
            burst.append(_small_grey(small, BURST_LONGEST_SIDE_PX))
        last, last_small, last_sparse, n_read = index, small, sparse, n_read + 1
    stacked = np.stack(burst) if burst else np.empty((0, 1, 1), np.uint8)
    sigma = difference_sigma(noise_counts)
    return CameraRecord(name, n_read, tuple(damage), tuple(black), change, sigma, burst_start, stacked, features)


def largest_change(grey: Image8, before: Image8) -> float:
    """Mean absolute difference of two grey images in the cell of a grid where it is largest, 0..255."""
    difference = cv2.absdiff(grey, before).astype(np.float32)
    cells = cv2.resize(difference, (CELLS_PER_SIDE, CELLS_PER_SIDE), interpolation=cv2.INTER_AREA)
    return float(cells.max())


def difference_sigma(counts: NDArray[np.int64]) -> float:
    """Standard deviation of a pixel's noise from how often each absolute difference of two frames occurs.

    The median is used, which a moving minority of the pixels does not disturb, and read between the integers: for a sigma of
    1.5 a plain median of integers would be 30 % off.

    Args:
        counts: occurrences of the differences 0, 1, 2, ..., (256,).
    """
    total = counts.sum()
    if not total:
        return float("nan")
    upto = np.cumsum(counts) / total  # a difference of k stands for all up to k + 1/2
    edges = np.arange(len(counts)) + 0.5
    median = float(np.interp(0.5, np.concatenate([[0.0], upto]), np.concatenate([[0.0], edges])))
    return median / 0.6745 / np.sqrt(2)


def _readable_frames(capture: Capture, name: str, damage: list[Damage]) -> Iterator[tuple[int, Image8]]:
    """Frames with their numbers; damage is noted and passed over in growing steps, so that a ruined file ends soon."""
    index = 0
    while index < capture.n_frames:
        try:
            for image in capture.frames(name, index):
                yield index, image
                index += 1
            if index < capture.n_frames:
                raise CaptureError(f"{capture.path}: {name} ends after {index} of {capture.n_frames} frames; restore it")
        except CaptureError as error:
            damage.append(Damage(index, str(error)))
            if len(damage) > RESTARTS:
                return
            index += 2 ** (len(damage) - 1)


def _small_grey(image: Image8, longest_side_px: int) -> Image8:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    scale = longest_side_px / max(grey.shape)
    if scale >= 1:
        return np.asarray(grey, np.uint8)
    size = (max(round(grey.shape[1] * scale), 1), max(round(grey.shape[0] * scale), 1))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)


def _sparse(image: Image8) -> Image8:
    """Every so many pixels of the green channel, not averaged."""
    step = max(min(image.shape[:2]) // NOISE_SAMPLES_PER_SIDE, 1)
    return np.ascontiguousarray(image[::step, ::step, 1])
