"""Tone: a second, a missing or a slightly different gamma, and the range of video levels."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.identity import Sample
from ggvs_eval.transforms import VIDEO_BLACK, VIDEO_SLOPE

# Levels are compared where nothing misplaced can mix them: pixels around which both pictures are flat, except for noise.
SMOOTH_PX, FLAT_PX, FLAT_255 = 0.7, 5, 12.0
BIN_255, FEWEST_PIXELS, FEWEST_BINS = 8, 40, 8
# Values at the ends may have been clipped.
LOWEST_255, HIGHEST_255 = 3.0, 252.0
# Honest renders of several methods came out at powers of 0.99 to 1.01, in each channel; a power of 1.1 at 1.09 and more.
LEAST_POWER, LARGEST_SPREAD = 1.05, 1.08
# A milky picture is affine: a power law has to leave less than the best affine map, and much less than a gain does. Planted
# powers of 1.1 left 0.3 to 0.61 and 0.11 to 0.32, honest renders of a rig whose cameras differ in colour by a fifth .77, .52.
LIKELY_TONE, CERTAIN_TONE, OF_GAIN = 0.7, 0.5, 0.5
CERTAIN_POWER = 1.5
# Cameras differ in exposure by some per cent.
LARGEST_GAIN, LARGEST_RANGE_GAIN = 1.1, 1.15
# Of the intercept, in levels: honest renders had 1.0 at most, squeezed ones 15.5 to 16.7.
LIKELY_BLACK_255, CERTAIN_BLACK_255 = 4.0, 3.0
# Levels that noise and averaging leave beyond video black and white.
FLOOR_255, CEILING_255 = 13.0, 238.0
QUESTION = "tone curve"
Curve = NDArray[np.float64]


@dataclass(frozen=True)
class ToneFit:
    """Tone curve of one channel: true levels to rendered ones.

    Attributes:
        power: of the best power law with a gain; of levels in 0..1.
        of_affine: its error relative to that of the best affine map.
        of_gain: its error relative to that of the best gain alone.
    """

    power: float
    of_affine: float
    of_gain: float
    slope: float
    intercept_255: float


def find_tone(name: str, sample: Sample) -> list[Finding]:
    """Fit the tone curve of each channel."""
    curves = tone_curves(sample)
    if min(len(curve) for curve in curves) < FEWEST_BINS:
        return []
    fits = [fit_tone(curve) for curve in curves]
    return _video_range(name, sample, fits) or _power_law(name, fits)


def of_all_views(findings: Sequence[Finding], views: int) -> list[Finding]:
    """Return the findings in a method's views, without likely tone curves of at most half of them.

    Reading:
        A program that writes frames by another curve writes all of them so. In one view it is the camera's: where one of a light
        field differs, every method that blends the others looked as if its frames had been written with a gamma of 0.93.
    """
    verdicts = [(finding.question, finding.verdict) for finding in findings]
    if 2 * verdicts.count((QUESTION, "likely")) > views:
        return list(findings)
    return [finding for finding, verdict in zip(findings, verdicts, strict=True) if verdict != (QUESTION, "likely")]


def tone_curves(sample: Sample) -> list[Curve]:
    """Return the median true and rendered level of flat pixels in each channel, by bins of the true level, (bins, 2)."""
    kernel = np.ones((FLAT_PX, FLAT_PX), np.uint8)
    both = [np.stack([cv2.GaussianBlur(one, (0, 0), SMOOTH_PX) for one in film]) for film in (sample.truth_now, sample.rendered)]
    ranges = [
        np.stack([np.maximum.reduce(cv2.split(cv2.dilate(image, kernel) - cv2.erode(image, kernel))) for image in images])
        for images in both
    ]
    flat = np.maximum(*ranges) < FLAT_255
    return [_levels(*(images[..., channel][flat] for images in both)) for channel in range(3)]


def _levels(theirs: NDArray[np.float32], ours: NDArray[np.float32]) -> Curve:
    bins = (theirs // BIN_255).astype(int)
    members = [bins == number for number in range(256 // BIN_255)]
    points = [(np.median(theirs[one]), np.median(ours[one])) for one in members if np.count_nonzero(one) >= FEWEST_PIXELS]
    curve = np.array(points, dtype=np.float64).reshape(-1, 2)
    return curve[((curve > LOWEST_255) & (curve < HIGHEST_255)).all(axis=1)]


def fit_tone(curve: Curve) -> ToneFit:
    """Fit a power law with a gain, an affine map and a gain to a tone curve, (bins, 2) on the scale 0..255."""
    theirs, ours = curve.T / 255
    slope, intercept = np.polyfit(theirs, ours, 1)
    affine = np.abs(slope * theirs + intercept - ours).mean()
    tried = np.geomspace(1 / 3, 3, 221)
    errors = np.array([_gain_free_error(theirs**power, ours) for power in tried])
    least, rounding = float(errors.min()), 0.2 / 255
    gain = _gain_free_error(theirs, ours)
    return ToneFit(
        float(tried[errors.argmin()]),
        (least + rounding) / (affine + rounding),
        (least + rounding) / (gain + rounding),
        float(slope),
        float(255 * intercept),
    )


def _gain_free_error(model: Curve, ours: Curve) -> float:
    """Return the error of a tone curve that may come with a cast of some per cent."""
    gain = np.clip((model * ours).sum() / max((model * model).sum(), 1e-9), 1 / LARGEST_GAIN, LARGEST_GAIN)
    return float(np.abs(gain * model - ours).mean())


def _power_law(name: str, fits: list[ToneFit]) -> list[Finding]:
    powers = [fit.power for fit in fits]
    power, rest = float(np.median(powers)), float(np.median([fit.of_affine for fit in fits]))
    strength, weakest = max(power, 1 / power), min(max(p, 1 / p) for p in powers)
    agree = max(powers) < max(LARGEST_SPREAD, strength**0.5) * min(powers)
    of_gain = float(np.median([fit.of_gain for fit in fits]))
    if weakest < LEAST_POWER or not agree or rest > LIKELY_TONE or of_gain > OF_GAIN:
        return []
    measured = (
        f"rendered = truth^{power:.2f} in each channel, levels in 0..1; leaves {rest:.2f} of the best affine map's residual"
    )
    verdict = verdict_of(strength > CERTAIN_POWER and rest < CERTAIN_TONE)
    return [Finding(name, QUESTION, verdict, measured, {"power": power, "rest_ratio": rest}, _power_advice(power))]


def _power_advice(power: float) -> str:
    if max(power, 1 / power) < CERTAIN_POWER:
        return "write with the capture's transfer function; neither sRGB nor BT.709 is a power of 2.2"
    if power > 1:
        return "encode linear light as sRGB before writing"
    return "write the image unchanged: it, or the reference, was encoded as sRGB twice"


def _video_range(name: str, sample: Sample, fits: list[ToneFit]) -> list[Finding]:
    """Return the levels squeezed into 16..235, or stretched from there although they were not.

    Both constants have to be met in each channel, and the cut must be seen: a milky or a dark rendering has an offset too.
    """
    if _is_squeezed(sample) and _nearness(fits, VIDEO_SLOPE, VIDEO_BLACK) < LIKELY_BLACK_255:
        what, black = "squeezed into 16..235", _nearness(fits, VIDEO_SLOPE, VIDEO_BLACK)
    elif _is_stretched(sample) and _nearness(fits, 1 / VIDEO_SLOPE, -VIDEO_BLACK / VIDEO_SLOPE) < LIKELY_BLACK_255 / VIDEO_SLOPE:
        what = "stretched from 16..235 to 0..255 although they were full range"
        black = _nearness(fits, 1 / VIDEO_SLOPE, -VIDEO_BLACK / VIDEO_SLOPE) * VIDEO_SLOPE
    else:
        return []
    slope, intercept = (float(np.median([getattr(fit, part) for fit in fits])) for part in ("slope", "intercept_255"))
    measured = f"levels are {what}: rendered = {slope:.2f} x truth {intercept:+.1f}, in each channel"
    values = {"slope": slope, "intercept_255": intercept}
    advice = "convert between full and limited range exactly once; mark the range in the video"
    return [Finding(name, "value range", verdict_of(black < CERTAIN_BLACK_255), measured, values, advice)]


def _nearness(fits: list[ToneFit], slope: float, intercept_255: float) -> float:
    """Return the largest deviation of the channels' intercepts, levels; infinite where a slope is none that exposure explains."""
    gains = [fit.slope / slope for fit in fits]
    if max(gains) > LARGEST_RANGE_GAIN or min(gains) < 1 / LARGEST_RANGE_GAIN:
        return float("inf")
    return max(abs(fit.intercept_255 - intercept_255) for fit in fits)


def _is_squeezed(sample: Sample) -> bool:
    """Return whether the rendering keeps between video black and white, to which the truth does not."""
    low, high = np.quantile(sample.rendered, [0.0005, 0.9995])
    true_low, true_high = np.quantile(sample.truth_now, [0.0005, 0.9995])
    return bool(low > FLOOR_255 and high < CEILING_255 and (true_low < FLOOR_255 - 2 or true_high > CEILING_255 + 2))


def _is_stretched(sample: Sample) -> bool:
    """Return whether what is dark in the truth, but not black, is black in the rendering, and holes are not why."""
    black = sample.rendered < 1.5
    dark, middle = ((low < sample.truth_now) & (sample.truth_now < high) for low, high in ((3, 13), (30, 80)))
    if np.count_nonzero(dark) < 50 or not middle.any():
        return False
    return bool(black[dark].mean() > 0.3 and black[middle].mean() < 0.1)
