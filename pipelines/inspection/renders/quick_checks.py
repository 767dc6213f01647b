"""The checks that every scoring carries: cheap ones of a burst of frames beside its truth; `examine` has all there are."""

from dataclasses import replace
from functools import lru_cache
from itertools import permutations

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.copied import find_copied
from ggvs_eval.pipelines.inspection.renders.identity import find_identity, remember
from ggvs_eval.pipelines.inspection.renders.offset import find_offset
from ggvs_eval.pipelines.inspection.renders.repeats import scan_frames
from ggvs_eval.pipelines.inspection.renders.tone import find_tone
from ggvs_eval.pipelines.inspection.renders.view_frames import (
    LARGEST_OFFSET,
    FrameReader,
    Sample,
    ViewFrames,
    longest_run,
    middle_of,
    shrink,
    take_sample,
)

CHANNELS = "RGB"
# Squared error of the hue (channels less their mean) relative to that of the order as it is.
CERTAIN_ORDER, LIKELY_ORDER = 0.5, 0.7
LEAST_HUE_255 = 3.0


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


SAMPLED_FRAMES = 12
# Copies are looked for at full size, which costs most. With fewer frames noise cannot be told from what stands still.
COPIED_FRAMES = 4


class QuickChecks:
    """Quick checks of one view, for any number of methods; the small captured frames are read once for all."""

    def __init__(self, view: str, truth: FrameReader, numbers: range) -> None:
        """Take the name of the view, its captured frames and the numbers of these."""
        self._view, self._truth, self._numbers = view, truth, numbers
        self._small_truth = _small(truth, SAMPLED_FRAMES + 2 * LARGEST_OFFSET)

    def check(self, rendered: FrameReader, frames: range) -> list[Finding]:
        """Find blank, repeated and mirrored frames, other instants, swapped channels, wrong tone and copies of the truth.

        All but copies are looked for in one burst in the middle, at small size. What moves a picture by less than a pixel, and
        whether it shows another camera, is left to `examine`.

        Args:
            rendered: frames of the truth's size.
            frames: their numbers, in a row.
        """
        burst = middle_of(frames, SAMPLED_FRAMES)
        view = ViewFrames(_small(rendered, len(burst)), self._small_truth, burst, self._numbers)
        scan = scan_frames(self._view, view)
        usable = longest_run(scan.usable)
        if not usable:
            return scan.findings
        view = replace(view, frames=usable)
        mirrored, view = find_identity(self._view, view, {self._view: remember(self._small_truth)})
        sampled, _ = check_sample(self._view, view)
        middle = ViewFrames(rendered, self._truth, middle_of(usable, COPIED_FRAMES), self._numbers)
        return [*scan.findings, *mirrored, *sampled, *find_copied(self._view, middle)]


def check_sample(name: str, view: ViewFrames, count: int = SAMPLED_FRAMES) -> tuple[list[Finding], ViewFrames]:
    """Ask a burst of neighbouring instants when it is, in which order of channels, and by which tone curve.

    Returns:
        What was found, and the view with time and channels mended.
    """
    sample = take_sample(view, count)
    shifted, view = find_offset(name, view, sample)
    sample = take_sample(view, count) if shifted else sample
    swapped, view = find_channel_order(name, view, sample)
    sample = take_sample(view, count) if swapped else sample
    return [*shifted, *swapped, *find_tone(name, sample)], view


def _small(read: FrameReader, kept: int) -> FrameReader:
    """Frames at the size of a sample, as many as are asked for again."""

    def read_small(index: int) -> Image8:
        return np.rint(shrink(read(index))).astype(np.uint8)

    return lru_cache(kept)(read_small)
