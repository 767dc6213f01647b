"""The scene without noise: still pixels averaged over time, moving ones smoothed as far as noise hides their contrast."""

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.metrics.noise.blocks import BLOCK_PX, ROUNDING_VARIANCE, Field, block_means
from ggvs_eval.metrics.noise.estimate import NoiseEstimator, NoiseModel

MEMORY_FRAMES = 30  # over which a still pixel is averaged
MIN_AGE_FRAMES = 3  # younger averages are no better than the frame
AROUND_FRAMES = 6  # before and after, over which pixels are averaged that stand still for a moment
STEP_255 = 1.0  # an average shown in 8 bit follows by steps of at least this; rounding each would make it tremble
SMOOTHING_PX = 7
CONTRAST_FACTOR = 4.0  # contrast up to this multiple of the noise's variance is smoothed away
STILL_FACTOR = 4.0  # mean squared residual of a block over the variance of its noise; a codec's noise varies by more than white
RIM_FACTOR = 1.4  # the same beside a block that moves


class CleanFrame(NamedTuple):
    """One frame of the scene as it may have been before the camera.

    Attributes:
        mean: the clean values, (H, W, 3), grey levels of 255, not rounded.
        shown: the same as a rendering shows it: whole grey levels, still where it stands still.
        averaged: pixels whose value is an average over time, (H, W, 1).
        strength: local standard deviation of the noise over that of the model, (H, W, 1).
    """

    mean: Field
    shown: Field
    averaged: NDArray[np.bool_]
    strength: Field


def observe(frames: Iterable[Image8]) -> tuple[NoiseModel, Field]:
    """First pass: the noise, and an average over the last frames to start the second pass from."""
    estimator, background = NoiseEstimator(), np.zeros((1, 1, 3), np.float32)
    for index, frame in enumerate(frames):
        estimator.add(frame)
        background = background + (frame - background) / np.float32(min(index + 1, MEMORY_FRAMES))
    return estimator.finish(), background


def clean_frames(
    frames: Iterable[Image8], noise: NoiseModel, background: Field, coding_variance: float = 0.0
) -> Iterator[tuple[Image8, CleanFrame]]:
    """Second pass: each captured frame and the clean one beside it.

    Args:
        frames: captured, (H, W, 3) uint8, consumed as a stream.
        noise: see `observe`.
        background: see `observe`.
        coding_variance: what a codec's steps let change where nothing moves, beyond that noise, grey levels squared.
    """
    rows, columns = (side // BLOCK_PX for side in background.shape[:2])
    age = np.full((rows, columns), min(noise.n_frames, MEMORY_FRAMES), np.float32)
    shown, strength = np.rint(background), np.ones_like(age)
    for before, frame, after in _with_neighbours(frames):
        residual = frame - background
        variance = block_means(noise.sigma_at(background) ** 2).mean(axis=-1) + ROUNDING_VARIANCE + coding_variance
        energy = np.asarray(block_means(residual * residual).mean(axis=-1) / (variance * (1 + 1 / age)), np.float32)
        still = _still(energy)
        strength = np.where(still, strength + (np.clip(energy, 0, 4) - strength) * np.float32(0.2), strength)
        settled = still & (age >= MIN_AGE_FRAMES)
        averaged = _to_pixels(settled, frame.shape)
        shown = np.where(np.abs(background - shown) > STEP_255, np.rint(background), shown)
        moving = _clean_moving(frame, (before, after), ~settled, variance, noise)
        mean, steady = (np.where(averaged, still_value, moving) for still_value in (background, shown))
        yield frame, CleanFrame(mean, steady, averaged, _to_pixels(np.sqrt(strength), frame.shape))
        age = np.where(still, np.minimum(age + 1, MEMORY_FRAMES), 1)
        background = background + residual / _to_pixels(age, frame.shape)


def rounded(frame: NDArray) -> Image8:
    """Grey levels as 8 bit."""
    return np.rint(np.clip(frame, 0, 255)).astype(np.uint8)


def _with_neighbours(frames: Iterable[Image8]) -> Iterator[tuple[list[Image8], Image8, list[Image8]]]:
    """Each frame with those before it, the nearest first, and those after it."""
    past: deque[Image8] = deque(maxlen=AROUND_FRAMES)
    stream = iter(frames)
    future = deque(islice(stream, AROUND_FRAMES + 1))
    while future:
        frame = future.popleft()
        yield list(past), frame, list(future)
        past.appendleft(frame)
        future.extend(islice(stream, 1))


def _clean_moving(
    frame: Image8,
    neighbours: tuple[list[Image8], list[Image8]],
    blocks: NDArray[np.bool_],
    variance: Field,
    noise: NoiseModel,
) -> Field:
    """A frame where it moves: averaged over neighbours while a block does not change, smoothed where it does at once."""
    total, count = frame.astype(np.float32), np.ones(blocks.shape, np.float32)
    for side in neighbours:
        unchanged = blocks
        for other in side:
            change = cv2.subtract(other, frame, dtype=cv2.CV_32F)
            energy = block_means(change * change).mean(axis=-1) / (2 * variance)
            unchanged = unchanged & _still(np.asarray(energy, np.float32))
            if not unchanged.any():
                break
            total += np.where(_to_pixels(unchanged, frame.shape), other, np.float32(0))
            count += unchanged
    enough = _to_pixels(count >= MIN_AGE_FRAMES, frame.shape)
    return np.where(enough, total / _to_pixels(count, frame.shape), _smoothed(frame, noise.sigma_at(frame)))


def _smoothed(frame: Image8, sigma: Field) -> Field:
    """A frame with its noise smoothed away where the local contrast is not above it: a local linear fit to the frame itself."""
    window = (SMOOTHING_PX, SMOOTHING_PX)
    image = frame.astype(np.float32)
    mean = cv2.blur(image, window)
    variance = cv2.blur(image * image, window) - mean * mean
    slope = np.maximum(variance - CONTRAST_FACTOR * sigma * sigma, 0) / np.maximum(variance, 1e-3)
    offset = mean * (1 - slope)
    return np.asarray(cv2.blur(slope, window) * image + cv2.blur(offset, window), dtype=np.float32)


def _still(energy: Field) -> NDArray[np.bool_]:
    """Blocks that do not move; beside one that does, less is allowed, since a rim that moves changes little."""
    moving = (energy > STILL_FACTOR).astype(np.uint8)
    beside = cv2.dilate(moving, np.ones((3, 3), np.uint8)) > 0
    return np.asarray(energy <= np.where(beside, RIM_FACTOR, STILL_FACTOR))


def _to_pixels(blocks: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Values of blocks at their pixels, (H, W, 1); the last blocks reach to the border."""
    rows, columns = (np.minimum(np.arange(side) // BLOCK_PX, side // BLOCK_PX - 1) for side in shape[:2])
    return blocks[rows][:, columns][..., None]
