"""Flicker of whole frames: gains that jump from one frame to the next."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import mean_of_channels
from ggvs_eval.finding import Finding
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames

FEWEST_FRAMES = 5
CELLS = 48
REGIONS = 4
# Added to both levels, so that their ratio means something in the dark.
DARK_255 = 4.0
# Usual change of the gain from one frame to the next, as the standard deviation of gains that do
# not depend on each other: honest renders had 0.1 % at most, random gains within 3 % have 1.7 %.
LEAST_FLICKER = 0.01
# Part of the change that sixteen regions have alike: 0.3 at most in honest renders, 1 if a frame is
# multiplied.
LEAST_COMMON = 0.7


def find_flicker(name: str, view: ViewFrames) -> list[Finding]:
    """Compare the gain of neighbouring frames.

    A drift, as by the exposure of the true camera, does not count.
    """
    if len(view.frames) < FEWEST_FRAMES:
        return []
    # (T, regions), logarithms
    gains = np.stack([region_gains(*pair) for pair in view.pairs(list(view.frames))])
    jumps = np.diff(gains, axis=0) / np.sqrt(2)
    common_jumps = np.diff(np.median(gains, axis=1)) / np.sqrt(2)
    size = float(np.sqrt(np.square(common_jumps).mean()))
    common = size / max(float(np.sqrt(np.square(jumps).mean())), 1e-9)
    if size < LEAST_FLICKER or common < LEAST_COMMON:
        return []
    largest = float(np.abs(common_jumps).max() * np.sqrt(2))
    text = (
        f"whole frames are brighter or darker by {100 * size:.1f} % (standard deviation), from one "
        f"to the next by up to {100 * largest:.1f} %"
    )
    values = {"flicker_share": size, "largest_jump_share": largest, "common_share": common}
    advice = (
        "write all frames with one exposure: is each normalised by its own minimum, maximum "
        "or mean?"
    )
    return [
        Finding(
            subject=name,
            question="flicker",
            verdict="likely",
            measured=text,
            values=values,
            advice=advice,
        )
    ]


def region_gains(rendered: Image8, truth: Image8) -> NDArray[np.float64]:
    """Return the logarithm of the usual ratio of rendered and true levels in each of 4 x 4 regions,
    (16,).
    """
    rendered_cells, truth_cells = (
        cv2.resize(mean_of_channels(image), (CELLS, CELLS), interpolation=cv2.INTER_AREA) + DARK_255
        for image in (rendered, truth)
    )
    side = CELLS // REGIONS
    cells = (
        np.log(rendered_cells / truth_cells).reshape(REGIONS, side, REGIONS, side).swapaxes(1, 2)
    )
    return np.asarray(np.median(cells.reshape(REGIONS**2, -1), axis=1), dtype=np.float64)
