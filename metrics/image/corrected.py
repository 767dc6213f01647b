"""PSNR, SSIM and LPIPS of the frame after an affine colour map.

The map removes the colour difference between target and source cameras, which no method can know.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.metrics.colour_moments import ColourMoments
from ggvs_eval.metrics.image.lpips import (
    distance_to_truth,
    frames_note,
    is_looked_at,
    lpips,
    weights_file,
)
from ggvs_eval.metrics.image.psnr import masked_psnr, psnr
from ggvs_eval.metrics.image.ssim import masked_ssim, ssim
from ggvs_eval.metrics.inputs import Image, check_pair, white_level
from ggvs_eval.metrics.metric import (
    QUALITY,
    ColourMap,
    FramePair,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
    shared_by_parts,
)


def psnr_colour_corrected(rendered: Image, truth: Image) -> float:
    """PSNR after the affine colour map (3 x 4) that fits the rendered pixels best to the truth.

    Args:
        rendered: one frame (H, W, 3) or the frames of one view (T, H, W, 3), uint8 in 0..255 or
            float in [0, 1].
        truth: same shape and kind.

    Returns:
        PSNR in dB as in `psnr`; with a stack, one map for all frames and the mean over the frames.

    Raises:
        MetricError: shapes or kinds differ.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> truth[:, 8:] = 180
        >>> psnr_colour_corrected(truth // 2, truth)  # half as bright: the map puts it right
        100.0

    Reading:
        See `ColourMoments`; the corrected frame is clipped to black and white and not rounded.
    """
    check_pair(rendered, truth, ndim=4 if truth.ndim == 4 else 3)
    rendered_frames, truth_frames = (
        image.reshape(-1, *truth.shape[-3:]) for image in (rendered, truth)
    )
    colour_map = fit_colour_map(rendered_frames, truth_frames)
    frames = zip(rendered_frames, truth_frames, strict=True)
    return float(
        np.mean(
            [
                psnr(apply_colour_map(colour_map, frame), unit_range(target))
                for frame, target in frames
            ]
        )
    )


class CorrectedScorer:
    """Metrics of the frame after an affine colour map.

    Without a map of the view each frame has its own.
    """

    def __init__(
        self, names: Sequence[str], options: MetricOptions, colour_map: ColourMap | None
    ) -> None:
        self.names = names
        self._options = options
        self._map = colour_map

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        corrected = _corrected(rendered, truth, self._map)
        captured = unit_range(truth.image)
        measures = {
            "PSNR_cc": lambda: psnr(corrected, captured),
            "SSIM_cc": lambda: ssim(corrected, captured),
            "LPIPS_cc": lambda: distance_to_truth(corrected, truth, self._options).value,
        }
        names = [
            name for name in self.names if name != "LPIPS_cc" or is_looked_at(index, self._options)
        ]
        return [(name, index, measures[name]()) for name in names]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return []


def _corrected(rendered: Image8, truth: TruthFrame, colour_map: ColourMap | None) -> Image:
    """Return the frame after the map of its view, or after its own if there is none.

    Once for all metrics and their parts.
    """

    def compute() -> Image:
        if colour_map is not None:
            return apply_colour_map(colour_map, rendered)
        moments = ColourMoments()
        moments.add(rendered, truth.image)
        return apply_colour_map(moments.map(), rendered)

    return shared_by_parts(rendered, truth, ColourMoments, compute)


def _psnr_inside(pair: FramePair, mask: Mask) -> float:
    return masked_psnr(
        _corrected(pair.rendered, pair.truth, pair.colour_map), unit_range(pair.truth.image), mask
    )


def _ssim_inside(pair: FramePair, mask: Mask) -> float:
    return masked_ssim(
        _corrected(pair.rendered, pair.truth, pair.colour_map), unit_range(pair.truth.image), mask
    )


def _lpips_inside(pair: FramePair, mask: Mask) -> float | None:
    if not is_looked_at(pair.index, pair.options):
        return None
    corrected = _corrected(pair.rendered, pair.truth, pair.colour_map)
    return distance_to_truth(corrected, pair.truth, pair.options).inside(mask)


PSNR_CC = ViewMetric(
    name="PSNR_cc",
    kind="frame",
    function=psnr_colour_corrected,
    unit="dB",
    higher_is_better=True,
    group=QUALITY,
    decimals=2,
    describe="PSNR after the best affine colour map of the view or frame",
    reference="as gsplat's cc_psnr",
    scorer=CorrectedScorer,
    inside=_psnr_inside,
    corrects_colours=True,
)
SSIM_CC = ViewMetric(
    name="SSIM_cc",
    kind="frame",
    function=ssim,
    higher_is_better=True,
    describe="SSIM after an affine colour map",
    reference="as gsplat's cc_ssim",
    scorer=CorrectedScorer,
    inside=_ssim_inside,
    inside_note=" in windows wholly inside it",
    corrects_colours=True,
)
LPIPS_CC = ViewMetric(
    name="LPIPS_cc",
    kind="frame",
    function=lpips,
    higher_is_better=False,
    describe="LPIPS after an affine colour map",
    note=frames_note,
    reference="as gsplat's cc_lpips",
    scorer=CorrectedScorer,
    inside=_lpips_inside,
    inside_note=", by the features whose pixels are in it",
    weights=weights_file,
    on_device=True,
    corrects_colours=True,
)


def fit_colour_map(rendered: Image, truth: Image) -> ColourMap:
    """Return one map for all frames of a view.

    Args:
        rendered: frames (T, H, W, 3).
    """
    check_pair(rendered, truth, ndim=4)
    moments = ColourMoments()
    for frame, target in zip(rendered, truth, strict=True):
        moments.add(frame, target)
    return moments.map()


def apply_colour_map(colour_map: ColourMap, frame: Image) -> NDArray[np.float32]:
    """Return the frame as the map changes it.

    Args:
        frame: (H, W, 3), uint8 in 0..255 or float in [0, 1].

    Returns:
        (H, W, 3) in [0, 1], clipped and not rounded; compare it with `unit_range` of the truth.
    """
    return np.clip(cv2.transform(unit_range(frame), colour_map.astype(np.float32)), 0.0, 1.0)


def unit_range(frame: Image) -> NDArray[np.float32]:
    """Return a frame as floats in [0, 1]."""
    return frame.astype(np.float32) / np.float32(white_level(frame))
