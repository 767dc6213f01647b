"""Tone: a second, a missing or a slightly different gamma, and the range of video levels."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.common_strength import pool_strengths
from ggvs_eval.pipelines.inspection.renders.identity import Sample, ViewFrames, take_sample
from ggvs_eval.pipelines.inspection.renders.undo import undo_changes
from ggvs_eval.transforms import VIDEO_BLACK, VIDEO_SLOPE

# Levels are compared where nothing misplaced can mix them: pixels around which both pictures are
# flat, except for noise.
SMOOTH_PX, FLAT_PX, FLAT_255 = 0.7, 5, 12.0
BIN_255, FEWEST_PIXELS, FEWEST_BINS = 8, 40, 8
# Values at the ends may have been clipped.
LOWEST_255, HIGHEST_255 = 3.0, 252.0
# Honest renders of several methods came out at powers of 0.99 to 1.01, in each channel; a power of
# 1.1 at 1.09 and more.
LEAST_POWER = 1.05
# A milky picture is affine: a power law has to leave less than the best affine map, and much less
# than a gain does. Planted powers of 1.1 left 0.3 to 0.61 and 0.11 to 0.32, honest renders of a rig
# whose cameras differ in colour by a fifth .77, .52.
LIKELY_TONE, CERTAIN_TONE, OF_GAIN = 0.7, 0.5, 0.5
CERTAIN_POWER = 1.5
# Cameras differ in exposure by some per cent.
LARGEST_GAIN, LARGEST_RANGE_GAIN = 1.5, 1.3
# Of the intercept, in levels: honest renders had 1.0 at most, squeezed ones 15.5 to 16.7.
LIKELY_BLACK_255, CERTAIN_BLACK_255 = 4.0, 3.0
# Levels that noise and averaging leave beyond video black and white.
FLOOR_255, CEILING_255 = 13.0, 238.0
QUESTION = "tone curve"
# Standard deviations over honest views, of logarithms; those of cameras' exposure and balance of
# red, green and blue.
HONEST_POWER, HONEST_GAINS = 0.012, np.array([0.02, 0.01, 0.01, 0.01])
# Light that is added, in levels: honest renders had 1.7 at most in a channel.
FEWEST_VIEWS, LARGEST_HAZE_255 = 2, 2.5
Curve = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ToneFits:
    """Tone curves, true levels to rendered ones, of some views in each channel.

    Arrays are (views, channels).

    Attributes:
        power: of the best power law with a gain; of levels in 0..1.
        of_affine: its error relative to that of the best affine map.
        of_gain: its error relative to that of the best gain alone.
        slope: of the best affine map.
        intercept_255: of the best affine map, in levels.
        gain: usual ratio of rendered and true levels.
    """

    power: NDArray[np.float64]
    of_affine: NDArray[np.float64]
    of_gain: NDArray[np.float64]
    slope: NDArray[np.float64]
    intercept_255: NDArray[np.float64]
    gain: NDArray[np.float64]


def find_levels(views: Mapping[str, ViewFrames], count: int) -> list[Finding]:
    """Look for a tone curve or a range of all views, then for the gain that is left.

    Args:
        views: the pictures are in place and of the right instants.
        count: neighbouring instants that are looked at in each view.
    """
    findings = find_tone({name: take_sample(view, count) for name, view in views.items()})
    straight = undo_changes(views, findings)
    return [
        *findings,
        *find_gain({name: take_sample(view, count) for name, view in straight.items()}),
    ]


def find_tone(samples: Mapping[str, Sample]) -> list[Finding]:
    """Fit the tone curve of each channel in all views.

    Reading:
        A program that writes frames by another curve writes all of them so. In some of the views a
        likely curve is the camera's: where one of a light field differs, every method that blends
        the others looked as if written with a gamma of 0.93.
    """
    fits = _fit_views(samples)
    findings = [] if fits is None else _video_range(samples, fits) or _power_law(samples, fits)
    if findings or len(samples) == 1:
        return findings
    return [
        finding
        for name in samples
        for finding in find_tone({name: samples[name]})
        if finding.verdict == "certain"
    ]


def _fit_views(samples: Mapping[str, Sample]) -> ToneFits | None:
    """Fit the tone curves; None where a curve has too few levels."""
    curves = [tone_curves(sample) for sample in samples.values()]
    if min((len(curve) for of_view in curves for curve in of_view), default=0) < FEWEST_BINS:
        return None
    return ToneFits(
        *np.array([[fit_tone(curve) for curve in of_view] for of_view in curves]).transpose(2, 0, 1)
    )


def find_gain(samples: Mapping[str, Sample]) -> list[Finding]:
    """Return the gains of red, green and blue that all views have alike.

    Reading:
        A single view may be brighter by the exposure of its camera, and some views by chance:
        cameras differ by some per cent, their colours by half as much. Haze adds light and is the
        method's own.
    """
    fits = _fit_views(samples)
    if (
        len(samples) < FEWEST_VIEWS
        or fits is None
        or abs(np.median(fits.intercept_255)) > LARGEST_HAZE_255
    ):
        return []
    gains = np.log(fits.gain)
    exposures = gains.mean(axis=1, keepdims=True)
    strength = pool_strengths(np.hstack([exposures, gains - exposures]), HONEST_GAINS, np.zeros(1))
    if strength.evidence.max() < 1:
        return []
    has_cast = strength.evidence[1:].max() >= 1
    gain = np.exp(strength.value[0] + has_cast * strength.value[1:])
    error = strength.half_width[0] + has_cast * strength.half_width[1]
    words = ", ".join(f"{channel:.3f}" for channel in gain)
    text = (
        f"red, green and blue are {words} of the truth's in all {len(samples)} views, within "
        f"{error:.3f}"
    )
    advice = (
        "is an exposure, a white balance or a normalisation applied to the frames, or to the "
        "captured ones alone?"
    )
    return [
        Finding(
            subject=name,
            question="gain",
            verdict="likely",
            measured=text,
            values={"gain": gain, "gain_error": error},
            advice=advice,
        )
        for name in samples
    ]


def tone_curves(sample: Sample) -> list[Curve]:
    """Return the median true and rendered level of flat pixels in each channel, by bins of the true
    level, (bins, 2).
    """
    kernel = np.ones((FLAT_PX, FLAT_PX), np.uint8)
    smooth_films = [
        np.stack([cv2.GaussianBlur(image, (0, 0), SMOOTH_PX) for image in film])
        for film in (sample.truth_now, sample.rendered)
    ]
    ranges = [
        np.stack(
            [
                np.maximum.reduce(cv2.split(cv2.dilate(image, kernel) - cv2.erode(image, kernel)))
                for image in images
            ]
        )
        for images in smooth_films
    ]
    flat = np.maximum(*ranges) < FLAT_255
    return [
        _levels(*(images[..., channel][flat] for images in smooth_films)) for channel in range(3)
    ]


def _levels(truth: NDArray[np.float32], rendered: NDArray[np.float32]) -> Curve:
    bins = (truth // BIN_255).astype(int)
    members = [bins == number for number in range(256 // BIN_255)]
    points = [
        (np.median(truth[mask]), np.median(rendered[mask]))
        for mask in members
        if np.count_nonzero(mask) >= FEWEST_PIXELS
    ]
    curve = np.array(points, dtype=np.float64).reshape(-1, 2)
    return curve[((curve > LOWEST_255) & (curve < HIGHEST_255)).all(axis=1)]


def fit_tone(curve: Curve) -> tuple[float, ...]:
    """Fit a power law with a gain, an affine map and a gain to a tone curve, (bins, 2) on the scale
    0..255: see `ToneFits`.
    """
    truth, rendered = curve.T / 255
    slope, intercept = np.polyfit(truth, rendered, 1)
    affine = np.abs(slope * truth + intercept - rendered).mean()
    tried = np.geomspace(1 / 3, 3, 221)
    errors = np.array([_gain_free_error(truth**power, rendered) for power in tried])
    least, rounding = float(errors.min()), 0.2 / 255
    gain = _gain_free_error(truth, rendered)
    return (
        tried[errors.argmin()],
        (least + rounding) / (affine + rounding),
        (least + rounding) / (gain + rounding),
        slope,
        255 * intercept,
        float(np.median(rendered / truth)),
    )


def _gain_free_error(model: Curve, rendered: Curve) -> float:
    """Return the error of a tone curve that may come with a cast of some per cent."""
    gain = np.clip(
        (model * rendered).sum() / max((model * model).sum(), 1e-9), 1 / LARGEST_GAIN, LARGEST_GAIN
    )
    return float(np.abs(gain * model - rendered).mean())


def _power_law(samples: Mapping[str, Sample], fits: ToneFits) -> list[Finding]:
    powers = np.log(fits.power)
    of_views, uneven = (part(powers, axis=1, keepdims=True) for part in (np.median, np.std))
    pooled = pool_strengths(of_views, HONEST_POWER, np.median(uneven, axis=0))
    residual = float(np.median(fits.of_affine))
    if pooled.evidence[0] < 1 or residual > LIKELY_TONE or np.median(fits.of_gain) > OF_GAIN:
        return []
    power = float(np.exp(pooled.value[0]))
    strength = max(power, 1 / power)
    if strength < LEAST_POWER:
        return []
    text = (
        f"rendered = truth^{power:.2f} in each channel, levels in 0..1; leaves {residual:.2f} "
        f"of the best affine map's residual"
    )
    verdict = verdict_of(strength > CERTAIN_POWER and residual < CERTAIN_TONE)
    values = {"power": power, "power_error": power * pooled.half_width[0], "rest_ratio": residual}
    return [
        Finding(
            subject=name,
            question=QUESTION,
            verdict=verdict,
            measured=text,
            values=values,
            advice=_power_advice(power),
        )
        for name in samples
    ]


def _power_advice(power: float) -> str:
    if max(power, 1 / power) < CERTAIN_POWER:
        return (
            "write with the capture's transfer function; neither sRGB nor BT.709 is a power of 2.2"
        )
    if power > 1:
        return "encode linear light as sRGB before writing"
    return "write the image unchanged: it, or the reference, was encoded as sRGB twice"


def _video_range(samples: Mapping[str, Sample], fits: ToneFits) -> list[Finding]:
    """Return the levels squeezed into 16..235, or stretched from there although they were not.

    Both constants have to be met in each channel, and the cut must be seen: a milky or a dark
    rendering has an offset too.
    """
    if all(map(_is_squeezed, samples.values())):
        state, slope, black_255 = "squeezed into 16..235", VIDEO_SLOPE, VIDEO_BLACK
    elif all(map(_is_stretched, samples.values())):
        state = "stretched from 16..235 to 0..255 although they were full range"
        slope, black_255 = 1 / VIDEO_SLOPE, -VIDEO_BLACK / VIDEO_SLOPE
    else:
        return []
    gain = np.exp(np.abs(np.log(fits.slope / slope)).max())
    off_255 = float(np.abs(np.median(fits.intercept_255, axis=0) - black_255).max()) / max(slope, 1)
    if gain > LARGEST_RANGE_GAIN or off_255 >= LIKELY_BLACK_255:
        return []
    values = {
        "slope": float(np.median(fits.slope)),
        "intercept_255": float(np.median(fits.intercept_255)),
    }
    text = (
        f"levels are {state}: rendered = {values['slope']:.2f} x truth "
        f"{values['intercept_255']:+.1f}, in each channel"
    )
    advice = "convert between full and limited range exactly once; mark the range in the video"
    verdict = verdict_of(off_255 < CERTAIN_BLACK_255)
    return [
        Finding(
            subject=name,
            question="value range",
            verdict=verdict,
            measured=text,
            values=values,
            advice=advice,
        )
        for name in samples
    ]


def _is_squeezed(sample: Sample) -> bool:
    """Return whether the rendering keeps between video black and white, to which the truth does
    not.
    """
    low, high = np.quantile(sample.rendered, [0.0005, 0.9995])
    true_low, true_high = np.quantile(sample.truth_now, [0.0005, 0.9995])
    return bool(
        low > FLOOR_255
        and high < CEILING_255
        and (true_low < FLOOR_255 - 2 or true_high > CEILING_255 + 2)
    )


def _is_stretched(sample: Sample) -> bool:
    """Return whether what is dark in the truth, but not black, is black in the rendering, and holes
    are not why.
    """
    black = sample.rendered < 1.5
    dark, middle = (
        (low < sample.truth_now) & (sample.truth_now < high) for low, high in ((3, 13), (30, 80))
    )
    if np.count_nonzero(dark) < 50 or not middle.any():
        return False
    return bool(black[dark].mean() > 0.3 and black[middle].mean() < 0.1)
