"""Further recordings of a coded video: its clean frames, with the sensor's noise, through the same
codec.

Clean frames are still pixels averaged over time, and moving ones smoothed as far as noise hides
their contrast.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.files.coding import Coding, read_coding
from ggvs_eval.files.images import round_levels
from ggvs_eval.files.video import X264, VideoFrames, write_video
from ggvs_eval.metrics.noise.blocks import BLOCK_PX, ROUNDING_VARIANCE, Field, block_means
from ggvs_eval.metrics.noise.estimate import NoiseEstimator, NoiseModel, estimate_noise

MEMORY_FRAMES = 30  # over which a still pixel is averaged
MIN_AGE_FRAMES = 3  # younger averages are no better than the frame
AROUND_FRAMES = 6  # before and after, over which pixels are averaged that are static for a moment
# an average shown in 8 bit follows by steps of at least this; rounding each would make it tremble
STEP_255 = 1.0
SMOOTHING_PX = 7
CONTRAST_FACTOR = 4.0  # contrast up to this multiple of the noise's variance is smoothed away
# mean squared residual of a block over the variance of its noise; a codec's noise varies by more
# than white
STILL_FACTOR = 4.0
RIM_FACTOR = 1.4  # the same next to a block that moves
LUMA = np.array([[0.2126, 0.7152, 0.0722]], np.float32)  # of BT.709
WINDOW_PX = 9  # of half size, over which strengths are compared
# grey levels squared; with less detail of brightness there is nothing to go by
LEAST_VARIANCE = 0.5
STEEPEST = 3.0


class CleanFrame(NamedTuple):
    """One frame of the scene as it may have been before the camera.

    Attributes:
        mean: the clean values, (H, W, 3), grey levels of 255, not rounded.
        display: the same as a rendering shows it: whole grey levels, still where it is static.
        averaged: pixels whose value is an average over time, (H, W, 1).
        strength: local standard deviation of the noise over that of the model, (H, W, 1).
    """

    mean: Field
    display: Field
    averaged: NDArray[np.bool_]
    strength: Field


def observe(frames: Iterable[Image8]) -> tuple[NoiseModel, Field]:
    """Return the first pass: the noise, and an average over the last frames to start the second
    pass from.
    """
    estimator, background = NoiseEstimator(), np.zeros((1, 1, 3), np.float32)
    for index, frame in enumerate(frames):
        estimator.add(frame)
        background = background + (frame - background) / np.float32(min(index + 1, MEMORY_FRAMES))
    return estimator.finish(), background


def clean_frames(
    frames: Iterable[Image8], noise: NoiseModel, background: Field, coding_variance: float = 0.0
) -> Iterator[tuple[Image8, CleanFrame]]:
    """Second pass: each captured frame and the clean one.

    Args:
        frames: captured, (H, W, 3) uint8, consumed as a stream.
        noise: see `observe`.
        background: see `observe`.
        coding_variance: what a codec's steps let change where nothing moves, beyond that noise,
            grey levels squared.
    """
    rows, columns = (side // BLOCK_PX for side in background.shape[:2])
    age = np.full((rows, columns), min(noise.n_frames, MEMORY_FRAMES), np.float32)
    display, strength = np.rint(background), np.ones_like(age)
    for before, frame, after in _with_neighbours(frames):
        residual = frame - background
        variance = (
            block_means(noise.sigma_at(background) ** 2).mean(axis=-1)
            + ROUNDING_VARIANCE
            + coding_variance
        )
        energy = np.asarray(
            block_means(residual * residual).mean(axis=-1) / (variance * (1 + 1 / age)), np.float32
        )
        still = _still(energy)
        strength = np.where(
            still, strength + (np.clip(energy, 0, 4) - strength) * np.float32(0.2), strength
        )
        settled = still & (age >= MIN_AGE_FRAMES)
        averaged = _to_pixels(settled, frame.shape)
        display = np.where(np.abs(background - display) > STEP_255, np.rint(background), display)
        moving = _clean_moving(frame, (before, after), ~settled, variance, noise)
        mean, steady = (
            np.where(averaged, still_value, moving) for still_value in (background, display)
        )
        yield (
            frame,
            CleanFrame(
                mean=mean,
                display=steady,
                averaged=averaged,
                strength=_to_pixels(np.sqrt(strength), frame.shape),
            ),
        )
        age = np.where(still, np.minimum(age + 1, MEMORY_FRAMES), 1)
        background = background + residual / _to_pixels(age, frame.shape)


def _with_neighbours(
    frames: Iterable[Image8],
) -> Iterator[tuple[list[Image8], Image8, list[Image8]]]:
    """Yield each frame with those before it, the nearest first, and those after it."""
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
    """Return a frame where it moves: averaged over neighbours while a block does not change,
    smoothed where it does at once.
    """
    total, count = frame.astype(np.float32), np.ones(blocks.shape, np.float32)
    for side in neighbours:
        unchanged = blocks
        for neighbour in side:
            change = cv2.subtract(neighbour, frame, dtype=cv2.CV_32F)
            energy = block_means(change * change).mean(axis=-1) / (2 * variance)
            unchanged = unchanged & _still(np.asarray(energy, np.float32))
            if not unchanged.any():
                break
            total += np.where(_to_pixels(unchanged, frame.shape), neighbour, np.float32(0))
            count += unchanged
    enough = _to_pixels(count >= MIN_AGE_FRAMES, frame.shape)
    return np.where(
        enough, total / _to_pixels(count, frame.shape), _smoothed(frame, noise.sigma_at(frame))
    )


def _smoothed(frame: Image8, sigma: Field) -> Field:
    """A frame with its noise smoothed away where the local contrast is not above it: a local linear
    fit to the frame itself.
    """
    window = (SMOOTHING_PX, SMOOTHING_PX)
    image = frame.astype(np.float32)
    mean = cv2.blur(image, window)
    variance = cv2.blur(image * image, window) - mean * mean
    slope = np.maximum(variance - CONTRAST_FACTOR * sigma * sigma, 0) / np.maximum(variance, 1e-3)
    offset = mean * (1 - slope)
    return np.asarray(cv2.blur(slope, window) * image + cv2.blur(offset, window), dtype=np.float32)


def _still(energy: Field) -> NDArray[np.bool_]:
    """Return the blocks that do not move.

    Next to one that does, less is allowed, since a rim that moves changes little.
    """
    moving = (energy > STILL_FACTOR).astype(np.uint8)
    beside = cv2.dilate(moving, np.ones((3, 3), np.uint8)) > 0
    return np.asarray(energy <= np.where(beside, RIM_FACTOR, STILL_FACTOR))


def _to_pixels(blocks: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Return the values of blocks at their pixels, (H, W, 1).

    The last blocks reach to the border.
    """
    rows, columns = (
        np.minimum(np.arange(side) // BLOCK_PX, side // BLOCK_PX - 1) for side in shape[:2]
    )
    return blocks[rows][:, columns][..., None]


def with_colour_detail(frame: Field) -> Field:
    """Guess the colours of a frame before they were stored at half size.

    Args:
        frame: decoded colours, (H, W, 3), grey levels of 255.

    Returns:
        The frame of the same brightness whose colours have detail of single pixels again, same
        shape.

    Reading:
        No decoder can give this detail back; only its strength is wanted, because it decides what a
        frame loses when it is coded again. In the octave below, which 4:2:0 keeps, the strength of
        colour relative to that of brightness is measured in each neighbourhood, with its sign,
        after brightness has gone through the same halving; that ratio is taken to hold one octave
        up, where brightness is known.
    """
    height, width = frame.shape[:2]
    luma = cv2.transform(frame, LUMA)
    as_colour = _halved_and_back(luma)
    half_luma, half_colour = (_half(plane) for plane in (as_colour, frame - luma[..., None]))
    luma_detail, colour_detail = (
        plane - _halved_and_back(plane) for plane in (half_luma, half_colour)
    )
    ratio = _strength(colour_detail, luma_detail[..., None])
    steep = cv2.resize(
        np.clip(ratio, -STEEPEST, STEEPEST), (width, height), interpolation=cv2.INTER_LINEAR
    )
    detailed = frame + steep * (luma - as_colour)[..., None]
    return np.asarray(
        detailed + (luma - cv2.transform(detailed, LUMA))[..., None], dtype=np.float32
    )


def _strength(colour: Field, luma: Field) -> Field:
    """Return the ratio of the local deviations, with the sign of the covariance, (h, w, 3)."""
    window = (WINDOW_PX, WINDOW_PX)
    of_luma, of_colour, together = (
        cv2.blur(product, window) for product in (luma * luma, colour * colour, colour * luma)
    )
    ratio = np.sqrt(of_colour / (of_luma[..., None] + LEAST_VARIANCE))
    return np.asarray(np.sign(together) * ratio, dtype=np.float32)


def _half(plane: Field) -> Field:
    height, width = plane.shape[:2]
    return np.asarray(
        cv2.resize(plane, (width // 2, height // 2), interpolation=cv2.INTER_AREA), dtype=np.float32
    )


def _halved_and_back(plane: Field) -> Field:
    """Halve and enlarge a plane, (H, W) or (H, W, C): bicubic both ways, smoothed before it is
    sampled.
    """
    from PIL.Image import Resampling, fromarray

    if plane.ndim == 3:
        return np.stack([_halved_and_back(plane[..., c]) for c in range(plane.shape[2])], axis=-1)
    height, width = plane.shape
    small = fromarray(np.ascontiguousarray(plane)).resize(
        ((width + 1) // 2, (height + 1) // 2), Resampling.BICUBIC
    )
    return np.asarray(small.resize((width, height), Resampling.BICUBIC), dtype=np.float32)


# changes that a codec makes where nothing moves, over the variance of rounding to its steps
STILL_STEPS = 2.0
TRIAL_FRAMES = 24  # on which the sensor's noise is found
TRIALS = 5
CLOSE = 0.01  # relative
KEEPING_STEPS = 0.55  # noise of this many steps of the codec keeps it from taking detail away
LARGEST_MISMATCH = 0.25  # logarithm of the ratio of variances
LARGEST_GRAIN = 0.12  # difference of the correlations of neighbouring pixels
LEAST_SIGMA = 0.05  # grey levels
TRIAL = 9  # number of the recordings on which it is found
MAX_SIGMA_255 = 12.0
FPS = 30.0


class Recorder:
    """A camera that films the clean frames of a captured view again.

    Args:
        frames: gives the captured frames of the view, from the first on each time it is called.
    """

    def __init__(
        self, frames: Callable[[], Iterable[Image8]], coding: Coding, seed: int, folder: Path
    ) -> None:
        self._frames, self._coding, self._seed, self._folder = frames, coding, seed, folder
        self.noise, self._background = observe(frames())
        self.sigma_255 = self._find_sensor_noise()

    def clean(self) -> Iterator[CleanFrame]:
        """Yield the clean frames, one by one, with the detail of colour that the codec took."""
        return iter(self._start) if self.noise.n_frames <= TRIAL_FRAMES else self._clean()

    @cached_property
    def _start(self) -> list[CleanFrame]:
        """The first of them, which are filmed most often."""
        return list(islice(self._clean(), TRIAL_FRAMES))

    def _clean(self) -> Iterator[CleanFrame]:
        variance = STILL_STEPS * self._coding.step_255**2 / 12
        for _, clean in clean_frames(self._frames(), self.noise, self._background, variance):
            display, mean = with_colour_detail(clean.display), with_colour_detail(clean.mean)
            yield clean._replace(display=display, mean=mean)

    def film(self, number: int, sigma_255: float) -> VideoFrames:
        """Recording of that number with noise of this deviation; other numbers have other noise."""
        return self._film(self.clean(), sigma_255, number)

    def doubt(self) -> str:
        """Return the reason why another recording cannot be simulated; empty if it can."""
        weakest = KEEPING_STEPS * self._coding.step_255
        if self.sigma_255 < weakest:
            hidden = f"below {weakest:.1f} grey levels x264 hides it at crf {self._coding.crf:g}"
            return f"sensor noise is too weak to measure after the codec: {hidden}"
        film = self._film(self._start, self.sigma_255, TRIAL)
        again = estimate_noise(film.frames(0, film.n_frames))
        captured = estimate_noise(islice(self._frames(), TRIAL_FRAMES))
        sums = [max(noise.octave_variance.sum(), LEAST_SIGMA**2) for noise in (again, captured)]
        levels = [np.maximum(noise.sigma_255, LEAST_SIGMA) for noise in (again, captured)]
        strength, by_level = np.log(sums[0] / sums[1]), 2 * np.log(levels[0] / levels[1])
        grain = again.spatial_correlation - captured.spatial_correlation
        if (
            max(abs(strength), np.median(np.abs(by_level))) > LARGEST_MISMATCH
            or abs(grain) > LARGEST_GRAIN
        ):
            return "noise is not white, or depends on brightness"
        return ""

    def _film(self, clean: Iterable[CleanFrame], sigma_255: float, number: int) -> VideoFrames:
        random = np.random.default_rng([self._seed, number])
        path = self._folder / f"{number}.mp4"
        noisy = (_expose(frame.mean, sigma_255, random) for frame in clean)
        write_video(path, noisy, FPS, self._coding.crf, f"{self._coding.settings}:{X264}")
        return VideoFrames(path)

    def _find_sensor_noise(self) -> float:
        """Return the standard deviation of the noise before the codec, grey levels of 255.

        Reading:
            What a codec leaves of weak noise changes from frame to frame no more than what the
            codec does alone, but every noisy block costs bits: of two recordings with the same
            settings, the one with more noise is longer. The clean frames are filmed with noise of
            several strengths until the film is as long as the capture.
        """
        captured = float(np.mean(self._coding.frame_bytes[:TRIAL_FRAMES]))
        sigmas, lengths = [0.0], [self._length(0.0)]
        guess = float(np.median(self.noise.sigma_255)) + 0.5
        if captured <= lengths[0]:
            return 0.0
        for _ in range(TRIALS):
            sigmas.append(guess)
            lengths.append(self._length(guess))
            if abs(lengths[-1] - captured) < CLOSE * captured:
                break
            order = np.argsort(sigmas)
            guess = float(
                np.interp(
                    captured, np.maximum.accumulate(np.take(lengths, order)), np.take(sigmas, order)
                )
            )
            if captured > max(lengths):
                guess = min(1.7 * max(sigmas), MAX_SIGMA_255)
        return guess

    def _length(self, sigma_255: float) -> float:
        film = self._film(self._start, sigma_255, TRIAL)
        return float(np.mean(read_coding(film.path, range(len(self._start))).frame_bytes))


def _expose(clean: Field, sigma_255: float, random: np.random.Generator) -> Image8:
    return round_levels(
        clean + np.float32(sigma_255) * random.standard_normal(clean.shape, np.float32)
    )
