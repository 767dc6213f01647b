"""Ceilings: scores of a perfect rendering on a captured view, without noise and as a second
recording.
"""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.files.coding import Coding
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.noise.blocks import Field
from ggvs_eval.metrics.noise.estimate import NoiseModel, NoiseStream
from ggvs_eval.metrics.noise.recording import Recorder, clean_frames, observe
from ggvs_eval.metrics.stream import ViewScores, score_views

# bounds behind every codec with loss: it softens what moves
SOFTENED, SOFTENED_TWICE = ("TCC", "STED"), ("STED",)
# of a bound, for the colour that is put back where 4:2:0 took it
MARGINS = {"PSNR": 1.0, "SSIM": 0.005}
MARGIN_SHARES = {"STED": 0.85}  # by which a bound is multiplied, for the noise that is drawn
FINEST_GRAIN = 0.4  # share of single pixels in the noise of colour; 4:2:0 leaves none
LEAST_VARIANCE = 0.05  # of noise whose grain can be measured, grey levels squared

Bound = Literal["at most", "at least"]
# a perfect score's
SIDES: dict[str, Bound] = {
    "PSNR": "at most",
    "SSIM": "at most",
    "TCC": "at most",
    "STED": "at least",
}


@dataclass(frozen=True)
class Ceilings:
    """Scores of perfect renderings of one view.

    Attributes:
        noise: what was found of the view's noise.
        noise_free: metric -> score of the scene itself, without noise, against the capture.
        second_recording: metric -> score of another recording, with independent noise, against the
            capture.
        averaged_share: share of the pixels whose clean value is an average over time; the rest
            moved and were estimated from the frame alone.
        not_computed: metric -> reason.
        bounds: metric -> that its noise-free score is a bound, and on which side; empty if scores
            are estimates.
        second_bounds: the same of the second recording.
        second_unknown: why there is no second recording; empty if there is one.
    """

    noise: NoiseModel
    noise_free: dict[str, float]
    second_recording: dict[str, float]
    averaged_share: float
    not_computed: dict[str, str]
    bounds: dict[str, Bound] = field(default_factory=dict)
    second_bounds: dict[str, Bound] = field(default_factory=dict)
    second_unknown: str = ""


def ceilings(
    frames: Callable[[], Iterable[Image8]],
    metrics: Sequence[str],
    options: MetricOptions | None = None,
    seed: int = 0,
    coding: Coding | None = None,
) -> Ceilings:
    """Estimate what perfect renderings of a captured view would score.

    Args:
        frames: gives the captured frames of the view, (H, W, 3) uint8, from the first on each time
            it is called; called twice, and more often where they were coded.
        metrics: names out of `registry.METRICS`, but no metric of the whole rig; see
            `registry.ceiling_metrics`.
        seed: of the noise that is drawn; equal seeds give equal bits.
        coding: how the frames were coded; None if each pixel is as the sensor gave it.

    Raises:
        MetricError: unknown metric, fewer than 2 frames, frames that differ in size, too little is
            static, or frames that were coded in an unknown way.

    Reading:
        Frames that were never coded, with their real noise, are the truth. Where a pixel is static,
        its average over time is the noise-free rendering, and the average with drawn noise is the
        second recording. Where it moves, no clean value is known: the captured frame with drawn
        noise is taken instead, of the strength that makes its difference from the truth that of the
        noise (once for the noise-free rendering, twice the variance for the second recording).

        What a codec takes from every frame is not seen in its frames. The clean frames are
        therefore filmed twice more, with the sensor's noise, taken for white, and through the same
        codec, and the first of these recordings is the truth. Noise of more than half a step of the
        codec keeps detail from being lost, and what is lost twice is what was lost once; only what
        moves, which no average restores, is softer in the clean frames than it was, so that the
        noise-free TCC and STED, and the second recording's STED, are bounds. Under weaker noise a
        codec takes detail that no second coding loses again: all of the noise-free row then is a
        bound, of a film without noise, and what a second recording would score is not known.
    """
    return (
        _of_sensor(frames, metrics, options, seed)
        if coding is None
        else _of_coded(frames, metrics, options, seed, coding)
    )


def _of_sensor(
    frames: Callable[[], Iterable[Image8]],
    metrics: Sequence[str],
    options: MetricOptions | None,
    seed: int,
) -> Ceilings:
    """Of frames as the sensor gave them: the truth is what was captured."""
    noise, background = observe(frames())
    if _is_coarse_in_colour(noise):
        reason = (
            "wanted colour with noise in single pixels, got colour of half size, as codecs store it"
        )
        raise MetricError(f"ceilings: {reason}; give the video itself instead of its frames")
    renderings = _PerfectRenderings(noise, background, np.random.default_rng([seed, 4]))
    noise_free, second = score_views(renderings.beside(frames()), metrics, options)
    return Ceilings(
        noise=noise,
        noise_free=_means(noise_free),
        second_recording=_means(second),
        averaged_share=renderings.averaged_share,
        not_computed={**second.not_computed, **noise_free.not_computed},
    )


def _of_coded(
    frames: Callable[[], Iterable[Image8]],
    metrics: Sequence[str],
    options: MetricOptions | None,
    seed: int,
    coding: Coding,
) -> Ceilings:
    """Of a coded video: renderings and truth are filmed from its clean frames."""
    if coding.unknown:
        raise MetricError(f"ceilings: the codec's loss is unknown: {coding.unknown}")
    height, width = next(iter(frames())).shape[:2]
    if (width, height) != tuple(coding.size):
        coded = "{} x {}".format(*coding.size)
        raise MetricError(
            f"ceilings: the codec's loss is unknown: coded at {coded}, measured at {width} x "
            f"{height}"
        )
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(frames=frames, coding=coding, seed=seed, folder=Path(folder))
        doubt = recorder.doubt()
        sigma_255 = 0.0 if doubt else recorder.sigma_255
        truth, second = (recorder.film(number, sigma_255) for number in (1, 2))
        averaged: list[float] = []
        instants = _beside(
            recorder, truth.frames(0, truth.n_frames), second.frames(0, second.n_frames), averaged
        )
        noise_free, again = score_views(instants, metrics, options)
    first_bounded = tuple(SIDES) if doubt else SOFTENED if coding.step_255 else ()
    second_bounded = SOFTENED_TWICE if coding.step_255 else ()
    return Ceilings(
        noise=recorder.noise,
        noise_free=_with_margins(_means(noise_free), first_bounded),
        second_recording={} if doubt else _with_margins(_means(again), second_bounded),
        averaged_share=float(np.mean(averaged)),
        not_computed={**again.not_computed, **noise_free.not_computed},
        bounds={name: SIDES[name] for name in first_bounded if name in metrics},
        second_bounds={}
        if doubt
        else {name: SIDES[name] for name in second_bounded if name in metrics},
        second_unknown=doubt,
    )


def _with_margins(scores: dict[str, float], bounded: Sequence[str]) -> dict[str, float]:
    """Return the scores, those that are bounds moved outwards."""
    shares = {name: MARGIN_SHARES.get(name, 1.0) if name in bounded else 1.0 for name in scores}
    return {
        name: value * shares[name] + (MARGINS.get(name, 0.0) if name in bounded else 0.0)
        for name, value in scores.items()
    }


def _beside(
    recorder: Recorder, truth: Iterable[Image8], second: Iterable[Image8], averaged: list[float]
) -> Iterator[tuple[tuple[Image8, Image8], Image8]]:
    """For each instant: (noise-free rendering, second recording), and the first.

    Notes the shares that were averaged.
    """
    for clean, first, again in zip(recorder.clean(), truth, second, strict=True):
        averaged.append(float(clean.averaged.mean()))
        yield (round_levels(clean.display), again), first


def _is_coarse_in_colour(noise: NoiseModel) -> bool:
    """Return whether noise of colour lacks the grain of single pixels, though there is noise:
    colours came at half size.
    """
    colour = noise.octave_variance[:, np.abs(noise.axes.sum(axis=0)).argsort()[:2]].sum(axis=1)
    return bool(colour.sum() > LEAST_VARIANCE and colour[0] < FINEST_GRAIN * colour.sum())


class _PerfectRenderings:
    """Second pass: for each captured frame, a noise-free rendering and a second recording of it."""

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
        """For each captured frame: (noise-free rendering, second recording), and the recording they
        are compared with.
        """
        first, second = (NoiseStream(self._noise, random) for random in self._random.spawn(2))
        for frame, clean in clean_frames(frames, self._noise, self._background):
            self._averaged.append(float(clean.averaged.mean()))
            truth = np.where(
                clean.averaged,
                frame,
                round_levels(clean.display + clean.strength * first.draw(clean.display)),
            )
            yield (
                (
                    round_levels(clean.display),
                    round_levels(clean.display + clean.strength * second.draw(clean.display)),
                ),
                truth,
            )


def _means(scores: ViewScores) -> dict[str, float]:
    """Return one number for each metric of the view: its own, or the mean over its frames."""
    values: dict[str, list[float]] = {}
    for name, _, value in scores.values:
        values.setdefault(name, []).append(value)
    return {name: float(np.mean(of_name)) for name, of_name in values.items()}
