"""What a perfect rendering could score on a captured view: without noise, and as a second recording by the same camera."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.noise.blocks import BLOCK_PX, ROUNDING_VARIANCE, Field, block_means
from ggvs_eval.metrics.noise.estimate import NoiseEstimator, NoiseModel, NoiseStream
from ggvs_eval.metrics.stream import ViewScores, score_views

MEMORY_FRAMES = 30  # over which a still pixel is averaged
MIN_AGE_FRAMES = 3  # younger averages are no better than the frame
STEP_255 = 1.0  # an average shown in 8 bit follows by steps of at least this; rounding each would make it tremble
SMOOTHING_PX = 7
CONTRAST_FACTOR = 4.0  # contrast up to this multiple of the noise's variance is smoothed away
STILL_FACTOR = 4.0  # mean squared residual of a block over the variance of its noise; a codec's noise varies by more than white
RIM_FACTOR = 1.4  # the same beside a block that moves


@dataclass(frozen=True)
class Ceilings:
    """Scores of perfect renderings of one view.

    Attributes:
        noise: what was found of the view's noise.
        noise_free: metric -> score of the scene itself, without noise, against the capture.
        second_recording: metric -> score of another recording, with noise of its own, against the capture.
        averaged_share: share of the pixels whose clean value is an average over time; the rest moved and were estimated from
            the frame alone.
        not_computed: metric -> reason.
    """

    noise: NoiseModel
    noise_free: dict[str, float]
    second_recording: dict[str, float]
    averaged_share: float
    not_computed: dict[str, str]


def ceilings(
    frames: Callable[[], Iterable[Image8]],
    metrics: Sequence[str],
    options: MetricOptions | None = None,
    seed: int = 0,
) -> Ceilings:
    """Estimate what perfect renderings of a captured view would score.

    Args:
        frames: gives the captured frames of the view, (H, W, 3) uint8, from the first on each time it is called; called twice.
        metrics: names out of `registry.METRICS`, but no metric of the whole rig; see `registry.ceiling_metrics`.
        options: as for the scores that stand beside.
        seed: of the noise that is drawn; equal seeds give equal bits.

    Raises:
        MetricError: unknown metric, fewer than 2 frames, frames that differ in size, or too little stands still.

    Reading:
        The captured frames, with their real noise, are the truth. Where a pixel stands still, its average over time is the
        noise-free rendering, and the average with drawn noise is the second recording. Where it moves, no clean value is known:
        the captured frame with drawn noise is taken instead, of the strength that makes its difference from the truth that of
        the noise (once for the noise-free rendering, twice the variance for the second recording). What the camera does to the
        scene in the same way in every frame, such as blur by its codec, belongs to the scene here.
    """
    noise, background = _observe(frames())
    renderings = _PerfectRenderings(noise, background, np.random.default_rng([seed, 4]))
    noise_free, second = score_views(renderings.beside(frames()), metrics, options)
    return Ceilings(
        noise, _means(noise_free), _means(second), renderings.averaged_share, {**second.not_computed, **noise_free.not_computed}
    )


def _observe(frames: Iterable[Image8]) -> tuple[NoiseModel, Field]:
    """First pass: the noise, and an average over the last frames to start the second pass from."""
    estimator, background = NoiseEstimator(), np.zeros((1, 1, 3), np.float32)
    for index, frame in enumerate(frames):
        estimator.add(frame)
        background = background + (frame - background) / np.float32(min(index + 1, MEMORY_FRAMES))
    return estimator.finish(), background


class _PerfectRenderings:
    """Second pass: beside each captured frame, a noise-free rendering and a second recording of it."""

    def __init__(self, noise: NoiseModel, background: Field, random: np.random.Generator) -> None:
        self._noise = noise
        self._background = background
        self._random = random
        self._averaged: list[float] = []

    @property
    def averaged_share(self) -> float:
        """Share of pixels, over the frames so far, that were averaged over time."""
        return float(np.mean(self._averaged)) if self._averaged else 0.0

    def beside(self, frames: Iterable[Image8]) -> Iterator[tuple[tuple[Image8, Image8], Image8]]:
        """For each captured frame: (noise-free rendering, second recording), and the recording they are compared with."""
        first, second = (NoiseStream(self._noise, random) for random in self._random.spawn(2))
        rows, columns = (side // BLOCK_PX for side in self._background.shape[:2])
        age = np.full((rows, columns), min(self._noise.n_frames, MEMORY_FRAMES), np.float32)
        shown = np.rint(self._background)
        strength = np.ones_like(age)
        for frame in frames:
            energy = self._residual_energy(frame, age)
            still = _still(energy)
            strength = np.where(still, strength + (np.clip(energy, 0, 4) - strength) * np.float32(0.2), strength)
            local = _to_pixels(np.sqrt(strength), frame.shape)
            averaged = _to_pixels(still & (age >= MIN_AGE_FRAMES), frame.shape)
            self._averaged.append(float(averaged.mean()))
            shown = np.where(np.abs(self._background - shown) > STEP_255, np.rint(self._background), shown)
            clean = np.where(averaged, shown, _smoothed(frame, self._noise.sigma_at(frame)))
            truth = np.where(averaged, frame, _rounded(clean + local * first.draw(clean)))
            yield (_rounded(clean), _rounded(clean + local * second.draw(clean))), truth
            age = np.where(still, np.minimum(age + 1, MEMORY_FRAMES), 1)
            self._background = self._background + (frame - self._background) / _to_pixels(age, frame.shape)

    def _residual_energy(self, frame: Image8, age: Field) -> Field:
        """Mean squared difference of each block from its average, over what noise alone would make it."""
        residual = frame - self._background
        variance = block_means(self._noise.sigma_at(self._background) ** 2).mean(axis=-1) + ROUNDING_VARIANCE
        return np.asarray(block_means(residual * residual).mean(axis=-1) / (variance * (1 + 1 / age)), dtype=np.float32)


def _smoothed(frame: Image8, sigma: Field) -> Field:
    """A frame with its noise smoothed away where the local contrast is not above it: a local linear fit to the frame itself."""
    import cv2

    window = (SMOOTHING_PX, SMOOTHING_PX)
    image = frame.astype(np.float32)
    mean = cv2.blur(image, window)
    variance = cv2.blur(image * image, window) - mean * mean
    slope = np.maximum(variance - CONTRAST_FACTOR * sigma * sigma, 0) / np.maximum(variance, 1e-3)
    offset = mean * (1 - slope)
    return np.asarray(cv2.blur(slope, window) * image + cv2.blur(offset, window), dtype=np.float32)


def _still(energy: Field) -> NDArray[np.bool_]:
    """Blocks that do not move; beside one that does, less is allowed, since a rim that moves changes little."""
    import cv2

    moving = (energy > STILL_FACTOR).astype(np.uint8)
    beside = cv2.dilate(moving, np.ones((3, 3), np.uint8)) > 0
    return np.asarray(energy <= np.where(beside, RIM_FACTOR, STILL_FACTOR))


def _to_pixels(blocks: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Values of blocks at their pixels, (H, W, 1); the last blocks reach to the border."""
    rows, columns = (np.minimum(np.arange(side) // BLOCK_PX, side // BLOCK_PX - 1) for side in shape[:2])
    return blocks[rows][:, columns][..., None]


def _rounded(frame: Field) -> Image8:
    return np.rint(np.clip(frame, 0, 255)).astype(np.uint8)


def _means(scores: ViewScores) -> dict[str, float]:
    """One number for each metric of the view: its own, or the mean over its frames."""
    found: dict[str, list[float]] = {}
    for name, _, value in scores.values:
        found.setdefault(name, []).append(value)
    return {name: float(np.mean(values)) for name, values in found.items()}
