"""Colour: channels in another order, a second or a missing gamma, and the range of video levels."""

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32
from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.view_frames import Sample, ViewFrames

CHANNELS = "RGB"
# Squared error of the hue (channels less their mean) relative to that of the order as it is.
CERTAIN_ORDER, LIKELY_ORDER = 0.5, 0.7
LEAST_HUE_255 = 3.0
QUANTILES = np.linspace(0.04, 0.96, 47)
# Honest renders, casts of 10 % and blur included, came out at powers of 0.89 to 1.17; a missing gamma is 2.2, a second one 0.45.
LEAST_POWER = 1.5
# A milky picture is affine, so a power law has to fit the levels about as well as any affine map, or better.
CERTAIN_TONE, LIKELY_TONE = 0.5, 1.2
VIDEO_BLACK, VIDEO_WHITE = 16.0, 235.0
# Cut-offs at video black and white in small pictures, where noise and averaging move them a little.
FLOOR_255, CEILING_255 = (14.0, 20.0), 236.5


def find_channel_order(name: str, view: ViewFrames, sample: Sample) -> tuple[list[Finding], ViewFrames]:
    """Compare the hue of the pictures under every order of the channels.

    The mean of the channels does not depend on their order and is left out.
    """
    ours, theirs = (images - images.mean(axis=-1, keepdims=True) for images in (sample.rendered, sample.truth_now))
    errors = {order: np.square(ours[..., list(order)] - theirs).mean(axis=(1, 2, 3)) for order in permutations(range(3))}
    straight = errors[0, 1, 2]
    order = min(errors, key=lambda key: float(errors[key].mean()))
    ratio = float((errors[order] / np.maximum(straight, 1e-6)).max())  # at every instant
    hue_255 = float(np.sqrt(np.square(theirs).mean()))
    if order == (0, 1, 2) or ratio > LIKELY_ORDER or hue_255 < LEAST_HUE_255:
        return [], view
    came = "".join(CHANNELS[list(order).index(channel)] for channel in range(3))
    values = {"hue_error_255": float(np.sqrt(straight.mean())), "hue_error_mended_255": float(np.sqrt(errors[order].mean()))}
    measured = (
        f"channels come as {came}: the hue is off by {values['hue_error_255']:.1f} of 255, "
        f"reordered by {values['hue_error_mended_255']:.1f}"
    )
    advice = "convert before writing: OpenCV reads and writes BGR" if came == "BGR" else "reorder the channels before writing"
    verdict = verdict_of(ratio < CERTAIN_ORDER)
    finding = Finding(name, "channel order", verdict, measured, values, advice)
    return [finding], view.with_rendered(lambda image: np.ascontiguousarray(image[..., list(order)]))


def find_tone(name: str, sample: Sample) -> list[Finding]:
    """Compare the distribution of levels: no misplaced edge disturbs it, as it would a comparison pixel by pixel."""
    ours, theirs = (levels(images) for images in (sample.rendered, sample.truth_now))  # (quantile, channel)
    found = _video_range(name, sample, ours, theirs)
    return found or _power_law(name, ours, theirs)


def levels(images: Array32) -> NDArray[np.float64]:
    """Quantiles of the levels of each channel over some frames, (Q, 3)."""
    return np.quantile(images.reshape(-1, 3), QUANTILES, axis=0)


def _power_law(name: str, ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> list[Finding]:
    powers, ratios = zip(*(_fit_power(ours[:, c] / 255, theirs[:, c] / 255) for c in range(3)), strict=True)
    power, ratio = float(np.median(powers)), float(np.median(ratios))
    agree = max(powers) < 1.35 * min(powers)
    if ratio > LIKELY_TONE or max(power, 1 / power) < LEAST_POWER or not agree:
        return []
    verdict = verdict_of(ratio < CERTAIN_TONE)
    advice = (
        "encode linear light as sRGB before writing"
        if power > 1
        else "write the image as it is: it was encoded as sRGB twice, or the truth was"
    )
    measured = (
        f"rendered = truth^{power:.2f} in each channel, levels in 0..1; leaves {ratio:.2f} of what the best affine map leaves"
    )
    return [Finding(name, "tone curve", verdict, measured, {"power": power, "rest_ratio": ratio}, advice)]


def _fit_power(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> tuple[float, float]:
    """Power that maps true to rendered levels, both in [0, 1], and its error relative to the best affine map's."""
    slope, intercept = np.polyfit(theirs, ours, 1)
    affine = np.abs(slope * theirs + intercept - ours).mean()
    tried = np.geomspace(1 / 3, 3, 111)
    errors = np.array([_gain_free_error(theirs**power, ours) for power in tried])
    return float(tried[errors.argmin()]), float(errors.min() / max(affine, 0.5 / 255))


def _gain_free_error(model: NDArray[np.float64], ours: NDArray[np.float64]) -> float:
    """Error of a tone curve that may come with a cast of some per cent."""
    gain = np.clip((model * ours).sum() / max((model * model).sum(), 1e-9), 0.9, 1.1)
    return float(np.abs(gain * model - ours).mean())


def _video_range(name: str, sample: Sample, ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> list[Finding]:
    """Levels squeezed into 16..235, or stretched from there although they were not.

    A straight line with such an offset is not enough, a milky or a dark rendering has one too: the cut must be seen.
    """
    fits = [np.polyfit(theirs[:, channel], ours[:, channel], 1) for channel in range(3)]
    slope, intercept = (float(value) for value in np.median(fits, axis=0))
    if _is_squeezed(sample) and 10.0 < intercept < 28.0 and 0.65 < slope < 1.0:
        what = "squeezed into 16..235"
    elif _is_stretched(sample) and -45.0 < intercept < -7.0 and slope > 0.9:
        what = "stretched from 16..235 to 0..255 although they were not within"
    else:
        return []
    measured = f"levels are {what}: rendered = {slope:.2f} x truth {intercept:+.0f}"
    values = {"slope": slope, "intercept_255": intercept}
    advice = "convert between full and limited range exactly once; mark the range in the video"
    return [Finding(name, "value range", "likely", measured, values, advice)]


def _is_squeezed(sample: Sample) -> bool:
    """Whether the rendering ends at video black and white although the truth goes below."""
    low, high = np.quantile(sample.rendered, [0.0005, 0.9995])
    return bool(FLOOR_255[0] < low < FLOOR_255[1] and high < CEILING_255 and np.quantile(sample.truth_now, 0.001) < 8)


def _is_stretched(sample: Sample) -> bool:
    """Whether what is dark in the truth, but not black, is black in the rendering, and holes are not why."""
    black = np.all(sample.rendered < 1.5, axis=-1)
    dark, middle = (((low < sample.truth_now) & (sample.truth_now < high)).all(axis=-1) for low, high in ((3, 14), (30, 80)))
    if np.count_nonzero(dark) < 50 or not middle.any():
        return False
    return bool(black[dark].mean() > 0.5 and black[middle].mean() < 0.1)
