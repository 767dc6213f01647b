"""Noise of sensor and codec, measured on the static parts of a captured view, and further
realisations of it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.noise.blocks import (
    MIN_BLOCKS,
    ROUNDING_VARIANCE,
    SCALES_PX,
    ChangeTable,
    Field,
    check_frame,
    enlarged,
    level_centres,
    octave_gains,
    octave_responses,
    octaves,
    shares_of,
)

LONG_LAG = 24  # frames after which noise that a codec holds is taken to be renewed
MIN_STATIC_SHARE = 0.05
MAX_HELD = 0.98


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one view: Gaussian, its strength by brightness, correlated over channels, space and
    time.

    Attributes:
        brightness_255: centres of the brightness bins, (B,), grey levels of 255.
        sigma_255: standard deviation per bin and channel, (B, 3), without that of rounding; between
            centres it is interpolated.
        axes: directions in RGB along which noise is uncorrelated, (3, 3), one per column.
        octave_variance: variance along each axis of the noise whose grain is 1, 2, 4, ... 32
            pixels, (6, 3).
        octave_held: what each of these keeps from one frame to the next, a correlation in [0, 1),
            (6, 3).
        static_share: share of the blocks, over all frames, that stood still and were used.
    """

    brightness_255: Array
    sigma_255: Array
    axes: Array
    octave_variance: Array
    octave_held: Array
    static_share: float
    n_frames: int

    @property
    def spatial_correlation(self) -> float:
        """Correlation of the noise of neighbouring pixels, mean of both directions and all
        channels; 0 for white noise.
        """
        share = shares_of(self.octave_variance)
        return float(share @ octave_responses()[1])

    def sigma_at(self, image: NDArray) -> Field:
        """Return the standard deviation of the noise at each value of an image, same shape, grey
        levels of 255.
        """
        levels = np.arange(256)
        curves = np.stack(
            [np.interp(levels, self.brightness_255, self.sigma_255[:, c]) for c in range(3)],
            axis=-1,
        )
        index = round_levels(image)
        return np.stack(
            [cv2.LUT(index[..., c], curves[:, c].astype(np.float32)) for c in range(3)], axis=-1
        )

    def sample(self, clean: NDArray, random: np.random.Generator) -> Image8:
        """Return one noisy recording of a clean frame (H, W, 3) in 0..255, rounded to 8 bit."""
        return next(self.sample_video([clean], random))

    def sample_video(
        self, clean: Iterable[NDArray], random: np.random.Generator
    ) -> Iterator[Image8]:
        """Yield a noisy recording of clean frames, one by one.

        What noise keeps over time is kept.
        """
        noise = NoiseStream(self, random)
        for frame in clean:
            yield round_levels(frame + noise.draw(frame))


class NoiseStream:
    """Noise for one frame after the other, all of one size.

    Args:
        random: source of all randomness; the same state gives the same noise, bit for bit.
    """

    def __init__(self, model: NoiseModel, random: np.random.Generator) -> None:
        self._model = model
        self._random = random
        self._held: dict[int, Field] = {}
        self._deviation = np.sqrt(
            np.maximum(
                np.einsum("ia,oa,ia->i", model.axes, model.octave_variance, model.axes), 1e-12
            )
        )

    def draw(self, clean: NDArray) -> Field:
        """Return the noise of the next frame, (H, W, 3), grey levels of 255, to be added to `clean`
        (H, W, 3) in 0..255.
        """
        height, width = clean.shape[:2]
        unit = np.zeros((height, width, 3), np.float32)
        for octave, variance in enumerate(self._model.octave_variance):
            if variance.max() > 0:
                unit += self._octave(octave, height, width)
        return unit * (self._model.sigma_at(clean) / self._deviation.astype(np.float32))

    def _octave(self, octave: int, height: int, width: int) -> Field:
        """Return the noise of one grain, drawn on its own coarse grid and carried over from the
        frame before.
        """
        grain = SCALES_PX[octave]
        persistence = self._model.octave_held[octave].astype(np.float32)
        rows, columns = -(-height // grain), -(-width // grain)
        fresh = self._random.standard_normal((rows, columns, 3), dtype=np.float32)
        before = self._held.get(octave)
        state = (
            fresh
            if before is None or not persistence.any()
            else persistence * before + np.sqrt(1 - persistence**2) * fresh
        )
        self._held[octave] = state
        # (3, 3), axis to RGB
        mixing = self._model.axes * np.sqrt(self._model.octave_variance[octave])
        coarse = cv2.transform(state, mixing.astype(np.float32))
        return np.asarray(
            enlarged(coarse, grain)[:height, :width] * np.float32(octave_gains()[octave]),
            dtype=np.float32,
        )


class NoiseEstimator:
    """Noise of a view from its frames, one at a time; three frames are held.

    Reading:
        Static are blocks of 8 x 8 pixels whose mean squared change is within the narrow peak that
        noise makes in the histogram of such changes; each brightness has its own peak. The mean
        over the 192 values of a block scatters so little that the cut above the peak takes off
        nothing of the noise, as a cut through single pixels would. Changes over 1 and over 24
        frames show how much of the noise is held (H.264 copies blocks and their noise). Noise that
        never changes is not distinguishable from the scene.
    """

    def __init__(self) -> None:
        self._frames = 0
        self._shape: tuple[int, ...] = ()
        self._previous: Image8 | None = None
        self._anchor: Image8 | None = None
        self._short, self._long = ChangeTable(), ChangeTable()

    def add(self, frame: Image8) -> None:
        """Take the next frame, (H, W, 3) uint8.

        Raises:
            MetricError: not an 8-bit RGB image, another size than before, or smaller than 16 x 16.
        """
        check_frame(frame, self._shape)
        self._shape = frame.shape
        if self._previous is None or self._anchor is None:
            self._anchor = frame
        else:
            self._short.add(frame, self._previous)
            if self._frames % LONG_LAG == 0:
                self._long.add(frame, self._anchor)
                self._anchor = frame
        self._previous = frame
        self._frames += 1

    def finish(self) -> NoiseModel:
        """Return the noise of all frames."""
        if self._frames < 2:
            raise MetricError(f"noise is a change between frames: {self._frames} frame; needs 2")
        limits = (self._long if self._long.n_blocks >= MIN_BLOCKS else self._short).limits()
        n_static, n_blocks = self._short.n_within(limits), self._short.n_blocks
        if n_static < max(MIN_BLOCKS, MIN_STATIC_SHARE * n_blocks):
            requirement = (
                f"wanted at least {MIN_STATIC_SHARE:.0%} of the blocks and {MIN_BLOCKS} "
                f"of them to be static"
            )
            raise MetricError(
                f"noise: {requirement}, got {n_static} of {n_blocks}; give more frames, or a view "
                f"with static content"
            )
        slow = self._long if self._long.n_within(limits) >= MIN_BLOCKS else self._short
        return self._model(slow, limits, n_static / n_blocks)

    def _model(
        self, slow: "ChangeTable", limits: NDArray[np.int64], static_share: float
    ) -> NoiseModel:
        _, axes = np.linalg.eigh(slow.covariance(limits))
        changing = octaves(self._short.variances(limits, axes))
        variance = np.maximum(octaves(slow.variances(limits, axes)), changing)
        with np.errstate(divide="ignore", invalid="ignore"):
            persistence = np.where(variance > 0, 1 - changing / variance, 0.0)
        sigma = np.sqrt(np.maximum(slow.variance_by_level(limits) - ROUNDING_VARIANCE, 0))
        return NoiseModel(
            brightness_255=level_centres(),
            sigma_255=sigma,
            axes=axes,
            octave_variance=variance,
            octave_held=np.clip(persistence, 0.0, MAX_HELD),
            static_share=float(static_share),
            n_frames=self._frames,
        )


def estimate_noise(frames: Iterable[Image8]) -> NoiseModel:
    """Return the noise of one captured view.

    Args:
        frames: (H, W, 3) uint8 in order, consumed as a stream.
    """
    estimator = NoiseEstimator()
    for frame in frames:
        estimator.add(frame)
    return estimator.finish()
