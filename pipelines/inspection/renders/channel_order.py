"""Order of the colour channels."""

from itertools import permutations

import numpy as np

from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.view_frames import Sample, ViewFrames

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
