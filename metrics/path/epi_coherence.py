"""Structure-tensor coherence of epipolar plane images: whether scene points draw straight lines as the camera moves."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.epi_lines import find_lines
from ggvs_eval.metrics.path.horizontal_path import HorizontalPath, horizontal_path
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathScorer, RenderedPath, whole_path

LEAST_TEXTURE_255 = 0.25
WIDER = 1.25
NAMES = ("EPI_coherence", "EPI_line_texture")


@dataclass(frozen=True)
class EpiCoherence:
    """Straightness of the lines in epipolar plane images.

    Attributes:
        coherence: 1 for straight lines, 0 where as much changes along the lines as across them, down to -1.
        line_texture_255: root mean square of the gradient that lies on straight lines, that is of what remains of the energy
            across the lines after the energy along them is taken off; grey levels of 255 per pixel. Blur removes noise and
            jitter and so can raise the coherence, but it lowers this number, and so do noise and jitter.
    """

    coherence: float
    line_texture_255: float


def epi_coherence(epis: Iterable[Image], path: HorizontalPath) -> EpiCoherence:
    """Coherence of the structure tensor over all pixels of epipolar plane images, weighted by gradient energy.

    Args:
        epis: one or more rows of the image over the poses, each (V, W, 3), uint8 in 0..255 or float in [0, 1]; consumed as a
            stream.

    Returns:
        (across - along) / (across + along), both summed over all pixels: `across` is the gradient energy across the line
        through a pixel and `along` the energy of the changes along it. The tensor's (l1 - l2) / (l1 + l2), weighted by its
        trace, where the line is the tensor's own axis.

    Reading:
        Not in the paper, which shows EPIs and counts nothing. A line's slope must be one that a depth between the path's near
        and far explains, each taken 1.25 times as wide, since captures state percentiles; so a flash is no line, and a frozen
        image is none where even the far end moves. Weighting by energy
        leaves flat regions without a vote; an image without any texture (less than 0.25 grey levels per pixel) has no score
        instead of a perfect one. Occlusions end lines, so a perfect rendering stays a little below 1.
    """
    across = along = 0.0
    pixels = 0
    slope_range_px = path.widened(WIDER).slope_range_px
    for epi in epis:
        lines = find_lines(epi, slope_range_px)
        across += float(lines.across.sum(dtype=np.float64))
        along += float(lines.along.sum(dtype=np.float64))
        pixels += lines.across.size
    if not pixels:
        raise MetricError("EPI coherence: no epipolar plane image to measure; give at least one row")
    texture_255 = (across / pixels) ** 0.5
    if texture_255 < LEAST_TEXTURE_255:
        raise MetricError(
            f"EPI coherence: {texture_255:.2f} grey levels per pixel of texture, wanted {LEAST_TEXTURE_255:g}; an image "
            "without texture draws no lines"
        )
    return EpiCoherence((across - along) / (across + along), (max(across - along, 0.0) / pixels) ** 0.5)


def _measure(path: RenderedPath) -> list[Value]:
    measured = epi_coherence(path.epis(), horizontal_path(path.cameras))
    return whole_path(NAMES, measured.coherence, measured.line_texture_255)


_SCORER = PathScorer(NAMES, _measure)
EPI_COHERENCE = PathMetric(
    name="EPI_coherence",
    function=epi_coherence,
    higher_is_better=True,
    describe="how straight the lines of epipolar plane images are",
    scorer=_SCORER,
)
EPI_LINE_TEXTURE = PathMetric(
    name="EPI_line_texture",
    function=epi_coherence,
    unit="grey levels per px",
    higher_is_better=True,
    describe="contrast across these lines; blur lowers it",
    scorer=_SCORER,
)
