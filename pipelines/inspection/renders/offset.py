"""Whether the rendered frames show other instants than the captured ones beside them."""

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


def find_offset(name: str, view: ViewFrames, sample: Sample) -> tuple[list[Finding], ViewFrames]:
    """Correlate the change over time of rendered and captured frames at every lag.

    What stands still is taken out by each pixel's mean over the instants, and with it most of what is wrong with a rendering;
    the gain of the motion, which blur lowers, does not matter either.
    """
    rendered, truth = _grey(sample.rendered), _grey(sample.truth)
    best: tuple[float, int, float, float, float] | None = None
    for lag in range(-LARGEST_OFFSET, LARGEST_OFFSET + 1):
        measured = _explained(rendered, truth, sample.indices.start - sample.truth_indices.start, lag) if lag else None
        if measured is not None and (best is None or measured[0] < best[0]):
            best = (measured[0], lag, *measured[1:])
    if best is None:
        return [], view
    ratio, lag, at_lag, at_zero, agreeing = best
    if ratio > LIKELY_RATIO or at_lag < LEAST_CORRELATION or agreeing < AGREEING_SHARE:
        return [], view
    verdict = verdict_of(ratio < CERTAIN_RATIO)
    values = {"offset_frames": float(lag), "correlation": at_lag, "correlation_without": at_zero, "agreeing_share": agreeing}
    measured_text = (
        f"frame t shows instant t{lag:+d}: motion correlates {at_lag:.2f} with it, {at_zero:.2f} with t, "
        f"{agreeing:.0%} of the instants agree"
    )
    advice = f"renumber the frames by {lag:+d}: first frame counted from 0 or 1, or another start in the protocol?"
    return [Finding(name, "frame offset", verdict, measured_text, values, advice)], view.moved(lag)


def _grey(frames: Array32) -> Array32:
    """Mean of the channels of each frame, noise smoothed a little, (n, h, w)."""
    return np.stack([cv2.GaussianBlur(frame.mean(axis=-1, dtype=np.float32), (0, 0), 1.0) for frame in frames])


def _explained(rendered: Array32, truth: Array32, first: int, lag: int) -> tuple[float, float, float, float] | None:
    """Unexplained motion at a lag relative to none, both correlations, and the share of instants that agree.

    Args:
        rendered: (n, h, w).
        truth: (m, h, w); the rendered frame i belongs to the truth `first` + i.
        first: see there.
        lag: how much later.
    """
    there = [i for i in range(len(rendered)) if 0 <= first + i + lag < len(truth)]
    if len(there) < FEWEST_FRAMES:
        return None
    ours, now, then = rendered[there], truth[[first + i for i in there]], truth[[first + i + lag for i in there]]
    ours, now, then = (frames - frames.mean(axis=0) for frames in (ours, now, then))
    at_lag, at_zero = correlation(ours, then), correlation(ours, now)
    each = [(correlation(a, c), correlation(a, b)) for a, b, c in zip(ours, now, then, strict=True)]
    agreeing = float(np.mean([lagged > straight for lagged, straight in each]))
    ratio = (1 - max(at_lag, 0.0) ** 2) / max(1 - max(at_zero, 0.0) ** 2, 1e-6)
    return ratio, at_lag, at_zero, agreeing
