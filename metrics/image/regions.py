"""Metrics of a part of the image: what stands still, what moves, what no source camera sees."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.metrics.image.psnr import decibels
from ggvs_eval.metrics.image.ssim_variants import SSIM_VARIANTS, ssim_map
from ggvs_eval.metrics.inputs import Image, check_mask, check_pair, require_finite, same_kind, white_level
from ggvs_eval.metrics.metric import REGION, ColourMap, MetricOptions, SsimName, TruthFrame, Value, ViewMetric

Region = Literal["static", "moving", "disoccluded"]
REGIONS: tuple[Region, ...] = get_args(Region)
# A change of colour by 9 of 255 levels at a quarter of the size, well above sensor noise averaged over 16 pixels.
MOVING_ABOVE_BETA = 0.05
BETA = 0.6
LEAST_PIXELS = 64


def moving_mask(truth: NDArray[np.uint8], previous: NDArray[np.uint8]) -> Mask:
    """Mask the pixels where the captured view moves, by the paper's difference mask (Eq. 1).

    Args:
        truth: captured frame, (H, W, 3) uint8.
        previous: the captured frame before.

    Returns:
        (H, W), true where something moves.

    Raises:
        MetricError: the frames differ in size or are not 8-bit RGB.

    Reading:
        The paper's mask is a weight in [beta, 1]; moving is where it rises 0.05 above beta, which is a colour change of 9 of 255
        levels. What moves was somewhere else before: both places count, as in the mask itself.
    """
    check_pair(truth, previous)
    if truth.dtype != np.uint8:
        raise MetricError(f"moving region: wanted uint8 in 0..255, got {truth.dtype}")
    return difference_mask(truth, previous, beta=BETA) > BETA + MOVING_ABOVE_BETA


def masked_psnr(rendered: Image, truth: Image, mask: Mask) -> float:
    """PSNR of the pixels inside a mask, dB, at most 100.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: same shape and kind.
        mask: (H, W).

    Raises:
        MetricError: images or mask do not fit each other, or fewer than 64 pixels inside.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> rendered, left = truth.copy(), np.arange(16) < 8
        >>> rendered[:, ~left] = 0
        >>> masked_psnr(rendered, truth, np.tile(left, (16, 1)))
        100.0
    """
    mean_squared_error = _norm_inside(rendered, truth, mask, cv2.NORM_L2SQR)
    return decibels(mean_squared_error, white_level(truth))


def masked_l1(rendered: Image, truth: Image, mask: Mask) -> float:
    """Mean absolute error of the pixels inside a mask on the scale 0..255; arguments as of `masked_psnr`.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> masked_l1(truth + 5, truth, np.ones((16, 16), bool))
        5.0
    """
    return require_finite(_norm_inside(rendered, truth, mask, cv2.NORM_L1) * 255.0 / white_level(truth), "L1")


def masked_ssim(rendered: Image, truth: Image, mask: Mask, name: SsimName = "gaussian-valid") -> float:
    """SSIM over the windows that lie wholly inside a mask.

    Windows that reach outside would compare what is not asked about, and windows in a blackened outside score 1: at 5 % coverage
    that turns 0.87 into 0.99.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: same shape and kind.
        mask: (H, W).
        name: which SSIM; windows that reach over the border of the image are left out of any of them.

    Raises:
        MetricError: images or mask do not fit each other, or no window inside.

    Example:
        >>> import numpy as np
        >>> truth = np.full((32, 32, 3), 100, np.uint8)
        >>> rendered, left = truth.copy(), np.arange(32) < 16
        >>> rendered[:, ~left] = 0
        >>> masked_ssim(rendered, truth, np.tile(left, (32, 1)))
        1.0
    """
    check_pair(rendered, truth)
    check_mask(mask, truth.shape[:2])
    box = _bounding_box(mask)  # no window outside it counts
    if min(mask[box].shape) < SSIM_VARIANTS[name].window_px:
        raise _no_window(name)
    return ssim_inside(ssim_map(rendered[box], truth[box], name), mask[box], name)


def ssim_inside(values: NDArray[np.float32], mask: Mask, name: SsimName = "gaussian-valid") -> float:
    """Mean of a map over the windows inside a mask, so that one `ssim_map` serves several regions.

    Args:
        values: `ssim_map` of the frame.
        mask: (H, W) of the frame.
        name: which SSIM the map is of.

    Raises:
        MetricError: the mask does not fit the map, or no window inside.
    """
    variant = SSIM_VARIANTS[name]
    check_mask(mask, tuple(size if variant.pads_with_zeros else size + variant.window_px - 1 for size in values.shape[:2]))
    window, radius = np.ones((variant.window_px, variant.window_px), np.uint8), variant.window_px // 2
    inside = cv2.erode(mask.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    chosen = values[inside if variant.pads_with_zeros else inside[radius:-radius, radius:-radius]]
    if not chosen.size:
        raise _no_window(name)
    return require_finite(float(chosen.mean(dtype=np.float64)), "SSIM")


def _no_window(name: SsimName) -> MetricError:
    side = SSIM_VARIANTS[name].window_px
    return MetricError(f"no window of {side} x {side} pixels lies wholly inside the region")


def _bounding_box(mask: Mask) -> tuple[slice, slice]:
    """Rows and columns of the smallest rectangle around what is true; empty where nothing is."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _norm_inside(rendered: Image, truth: Image, mask: Mask, kind: int) -> float:
    """Mean over the pixels inside and their channels of what `kind` adds up."""
    check_pair(rendered, truth)
    check_mask(mask, truth.shape[:2])
    n_pixels = int(np.count_nonzero(mask))
    if n_pixels < LEAST_PIXELS:
        raise MetricError(f"the region has {n_pixels} pixels; needs {LEAST_PIXELS}")
    return float(cv2.norm(*same_kind(rendered, truth), kind, mask.astype(np.uint8))) / (3 * n_pixels)


def region_mask(truth: TruthFrame, region: Region) -> Mask | None:
    """Return the mask of a region; None in the first frame, where motion is undefined, and where masks are not known."""
    previous = truth.previous
    if region == "disoccluded":
        return truth.disoccluded
    if previous is None:
        return None
    moving = truth.once(moving_mask, lambda: moving_mask(truth.image, previous))
    return moving if region == "moving" else ~moving


MEASURES: dict[str, Callable[[Image, Image, Mask], float]] = {"PSNR": masked_psnr, "SSIM": masked_ssim, "L1": masked_l1}
UNITS = {"PSNR": "dB", "SSIM": "", "L1": "grey levels of 255"}
WORDS: dict[Region, str] = {
    "static": "what stands still",
    "moving": "what moves",
    "disoccluded": "what no source camera sees",
}


class RegionScorer:
    """Metrics of one region; frames in which it is too small, or not known, have no value."""

    def __init__(self, region: Region, measures: Sequence[str]) -> None:
        self.names = [f"{measure}_{region}" for measure in measures]
        self._region = region
        self._measures = measures
        self._reasons = {name: "no masks are known; run `ggvs-eval prepare`" for name in self.names}
        self._measured: set[str] = set()

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        mask = region_mask(truth, self._region)
        if mask is None:
            return []
        values: list[Value] = []
        for name, measure in zip(self.names, self._measures, strict=True):
            try:
                values.append((name, index, MEASURES[measure](rendered, truth.image, mask)))
                self._measured.add(name)
            except MetricError as error:
                self._reasons[name] = str(error)
        return values

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        absent = [name for name in self.names if name not in self._measured]
        if absent:
            raise MetricError(f"{', '.join(absent)}: in no frame, {self._reasons[absent[0]]}")
        return []


def _region_scorer(region: Region, names: Sequence[str], _options: MetricOptions, _colour_map: ColourMap | None) -> RegionScorer:
    return RegionScorer(region, [measure for measure in MEASURES if f"{measure}_{region}" in names])


def _metrics_of(region: Region) -> tuple[ViewMetric, ...]:
    """The metrics of one region, which share its mask."""
    scorer = partial(_region_scorer, region)
    return tuple(
        ViewMetric(
            name=f"{measure}_{region}",
            kind="frame",
            function=function,
            unit=UNITS[measure],
            higher_is_better=measure != "L1",
            group=REGION,
            describe=f"{measure} of {WORDS[region]}{' in windows wholly inside it' if measure == 'SSIM' else ''}",
            reference="regions by the masks of Eq. 1",
            scorer=scorer,
        )
        for measure, function in MEASURES.items()
    )


REGION_METRICS = tuple(metric for region in REGIONS for metric in _metrics_of(region))
