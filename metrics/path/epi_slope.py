"""Agreement of the lines in epipolar plane images with depth: near points must move faster, and by the right amount."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.epi_lines import Lines, find_lines
from ggvs_eval.metrics.path.horizontal_path import HorizontalPath, horizontal_path
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathScorer, RenderedPath, SlopeOptions, whole_path

BIN_PX = 1.0 / 1024
WIDER_PX = 1.0
NAMES = ("EPI_slope_error", "EPI_slope_agreeing", "EPI_slope_measured")
NO_SLOPE = "EPI slope: no pixel has texture and a coherent line; no slope to compare with depth's"


@dataclass(frozen=True)
class SlopeAgreement:
    """Agreement between the slopes that the images show and those that depth predicts.

    Attributes:
        median_error_px: median absolute difference over the measured pixels, px per pose step; None where none was measured.
        agreeing_share: pixels whose slope could be measured and agrees, of all pixels with a depth. Blur lowers it.
        measured_share: pixels whose slope could be measured, of all pixels with a depth.
        predicted_px: mean absolute predicted slope, px per pose step: the error of an image that never moves.
    """

    median_error_px: float | None
    agreeing_share: float
    measured_share: float
    predicted_px: float


def slope_agreement(
    epis: Iterable[tuple[Image, NDArray[np.float32]]], path: HorizontalPath, options: SlopeOptions | None = None
) -> SlopeAgreement:
    """Compare the slope of the lines in epipolar plane images with the slope that depth predicts, -f * step / z.

    Args:
        epis: pairs of an EPI, (V, W, 3), uint8 in 0..255 or float in [0, 1], and the same rows of the poses' depth, (V, W)
            float32, world units, 0 = unknown; consumed as a stream.
        options: thresholds; the defaults where None.

    Returns:
        The agreement over all pixels; the median is exact to 0.001 px.

    Reading:
        Not in the paper. Slopes are searched 1 px beyond those of near and far, and from there to 0, so that an image that
        stands still shows it. The first and last two poses and a margin of columns have no whole window and no vote.
    """
    options = options or SlopeOptions()
    low, high = path.slope_range_px
    slope_range_px = min(low, 0.0) - WIDER_PX, max(high, 0.0) + WIDER_PX
    bins = np.zeros(int((slope_range_px[1] - slope_range_px[0]) / BIN_PX) + 2, np.int64)
    n_with_depth = agreeing = 0
    predicted_sum = 0.0
    for epi, depth in epis:
        if depth.shape != epi.shape[:2]:
            raise MetricError(f"EPI slope: the EPI is {epi.shape}, its depth {depth.shape}; wanted one depth per pixel")
        lines = find_lines(epi, slope_range_px)
        predicted = path.slope_px(_inner(depth, lines))
        has_depth = predicted != 0
        error = np.abs(lines.slope_px - predicted)[has_depth & _is_measured(lines, options)]
        bins += np.bincount(np.minimum(error / BIN_PX, len(bins) - 1).astype(np.int64), minlength=len(bins))
        n_with_depth += int(np.count_nonzero(has_depth))
        agreeing += int(np.count_nonzero(error <= options.tolerance_px))
        predicted_sum += float(np.abs(predicted).sum(dtype=np.float64))
    if not n_with_depth:
        raise MetricError("EPI slope: no depth along the path; give depth maps of the poses to compare slopes with")
    return SlopeAgreement(_median(bins), agreeing / n_with_depth, int(bins.sum()) / n_with_depth, predicted_sum / n_with_depth)


def _median(bins: NDArray[np.int64]) -> float | None:
    """Middle of the bin that holds the (lower) median, px."""
    count = int(bins.sum())
    return (int(np.searchsorted(np.cumsum(bins), (count + 1) // 2)) + 0.5) * BIN_PX if count else None


def _inner(depth: NDArray[np.float32], lines: Lines) -> NDArray[np.float32]:
    """The part of an EPI's depth where lines were measured."""
    return depth[2:-2, lines.first_column : depth.shape[1] - lines.first_column]


def _is_measured(lines: Lines, options: SlopeOptions) -> NDArray[np.bool_]:
    """Tell where texture and coherence suffice to trust a slope."""
    coherent = lines.across - lines.along >= options.least_coherence * (lines.across + lines.along)
    return coherent & (lines.across >= options.least_texture_255**2)


def _measure(path: RenderedPath) -> list[Value]:
    depths = [depth for depth in path.depths if depth is not None]
    if len(depths) < len(path.cameras):
        raise MetricError(f"EPI slope: {len(depths)} of {len(path.cameras)} poses have a depth; give all of them one")
    pairs = ((epi, np.stack([depth[row] for depth in depths])) for row, epi in enumerate(path.epis()))
    measured = slope_agreement(pairs, horizontal_path(path.cameras), path.options.slope)
    shares = whole_path(NAMES[1:], measured.agreeing_share, measured.measured_share)
    if measured.median_error_px is None:
        return shares
    return [*whole_path(NAMES[:1], measured.median_error_px), *shares]


_SCORER = PathScorer(NAMES, _measure, NO_SLOPE)
EPI_SLOPE_ERROR = PathMetric(
    name="EPI_slope_error",
    function=slope_agreement,
    unit="px per pose",
    higher_is_better=False,
    describe="their slope against that of the fused depth",
    scorer=_SCORER,
)
EPI_SLOPE_AGREEING = PathMetric(
    name="EPI_slope_agreeing",
    function=slope_agreement,
    higher_is_better=True,
    describe="share of pixels whose slope agrees with the fused depth",
    scorer=_SCORER,
)
