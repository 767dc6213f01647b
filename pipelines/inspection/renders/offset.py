"""Temporal offset: rendered frames that show other instants than the captured ones, earlier, later or reversed."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Array32
from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.identity import correlation
from ggvs_eval.pipelines.inspection.renders.view_frames import LARGEST_OFFSET, Sample, ViewFrames

FEWEST_FRAMES = 4
# Motion left unexplained, 1 - correlation^2, relative to no offset on the same frames. Honest renders of 18 to 30 dB had 1.09 and
# more at every lag, and a frame's offset 0.92 at most, however slow the motion.
CERTAIN_RATIO, LIKELY_RATIO = 0.88, 0.96
LEAST_CORRELATION = 0.45
# Share of the instants, each on its own, at which the offset must explain more.
AGREEING_SHARE = 0.75


@dataclass(frozen=True)
class _Timing:
    """Instants that the frames show, and how well that explains them.

    Attributes:
        is_reversed: the last frame comes first.
        ratio: motion left unexplained, relative to no offset on the same frames.
        correlation: of the motion with that of the instants shown.
        straight: correlation with that of the instants of the frames' numbers.
        agreeing: share of the instants, each on its own, at which the former is larger.
    """

    lag: int
    is_reversed: bool
    ratio: float
    correlation: float
    straight: float
    agreeing: float


def find_offset(name: str, view: ViewFrames, sample: Sample) -> tuple[list[Finding], ViewFrames]:
    """Correlate the change over time of rendered and captured frames at every lag, forwards and backwards.

    What stands still is taken out by each pixel's mean over the instants, and with it most of what is wrong with a rendering;
    the gain of the motion, which blur lowers, does not matter either.
    """
    rendered, truth = _grey(sample.rendered), _grey(sample.truth)
    lags = range(-LARGEST_OFFSET, LARGEST_OFFSET + 1)
    turning = view.frames.start + view.frames[-1]
    shown = {(lag, False): [index + lag for index in sample.indices] for lag in lags if lag}
    shown |= {(lag, True): [turning - index + lag for index in sample.indices] for lag in lags}
    tried = [_timing(sample, rendered, truth, numbers, *key) for key, numbers in shown.items()]
    best = min((one for one in tried if one is not None), key=lambda one: one.ratio, default=None)
    if best is None or best.ratio > LIKELY_RATIO or best.correlation < LEAST_CORRELATION or best.agreeing < AGREEING_SHARE:
        return [], view
    if best.is_reversed:
        return [_finding(name, best)], view.reversed(best.lag)
    return [_finding(name, best)], view.moved(best.lag)


def _finding(name: str, timing: _Timing) -> Finding:
    values = {
        "offset_frames": float(timing.lag),
        "correlation": timing.correlation,
        "correlation_without": timing.straight,
        "agreeing_share": timing.agreeing,
    }
    shown = f"the frames come in reversed order{f', {timing.lag:+d}' if timing.lag else ''}" if timing.is_reversed else ""
    measured = (
        f"{shown or f'frame t shows instant t{timing.lag:+d}'}: motion correlates {timing.correlation:.2f} with it, "
        f"{timing.straight:.2f} with t, {timing.agreeing:.0%} of the instants agree"
    )
    advice = f"renumber the frames by {timing.lag:+d}: first frame counted from 0 or 1, or another start in the protocol?"
    question = "reversed time" if timing.is_reversed else "frame offset"
    advice = "number the frames from the first instant to the last" if timing.is_reversed else advice
    return Finding(name, question, verdict_of(timing.ratio < CERTAIN_RATIO), measured, values, advice)


def _grey(frames: Array32) -> Array32:
    """Mean of the channels of each frame, noise smoothed a little, (n, h, w)."""
    return np.stack([cv2.GaussianBlur(frame.mean(axis=-1, dtype=np.float32), (0, 0), 1.0) for frame in frames])


def _timing(
    sample: Sample, rendered: Array32, truth: Array32, numbers: Sequence[int], lag: int, is_reversed: bool
) -> _Timing | None:
    """Correlate the frames with the instants of these numbers; None where the truth has too few of them.

    Args:
        rendered: (n, h, w).
        truth: (m, h, w).
        lag: for the record, as is `is_reversed`.
    """
    instants = sample.truth_indices
    pairs = [(i, number) for i, number in enumerate(numbers) if number in instants]
    if len(pairs) < FEWEST_FRAMES:
        return None
    ours = rendered[[i for i, _ in pairs]]
    now = truth[[sample.indices[i] - instants.start for i, _ in pairs]]
    then = truth[[number - instants.start for _, number in pairs]]
    ours, now, then = (frames - frames.mean(axis=0) for frames in (ours, now, then))
    shown, straight = correlation(ours, then), correlation(ours, now)
    each = [correlation(a, c) > correlation(a, b) for a, b, c in zip(ours, now, then, strict=True)]
    ratio = (1 - max(shown, 0.0) ** 2) / max(1 - max(straight, 0.0) ** 2, 1e-6)
    return _Timing(lag, is_reversed, ratio, shown, straight, float(np.mean(each)))
