"""Metrics of parts of the image: static, moving, and unseen by every source camera."""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.metric import (
    REGION,
    ColourMap,
    FramePair,
    Inside,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
)

Region = Literal["static", "moving", "disoccluded"]
WORDS: dict[Region, str] = {
    "static": "static areas",
    "moving": "what moves",
    "disoccluded": "areas that no source camera sees",
}
# A change of colour by 9 of 255 levels at a quarter of the size, well above sensor noise averaged
# over 16 pixels.
MOVING_ABOVE_BETA = 0.05
BETA = 0.6


def moving_mask(truth: NDArray[np.uint8], previous: NDArray[np.uint8]) -> Mask:
    """Mask the pixels where the captured view moves, by the paper's difference mask (Eq. 1).

    Args:
        truth: captured frame, (H, W, 3) uint8.

    Returns:
        (H, W), true where something moves.

    Reading:
        The paper's mask is a weight in [beta, 1]; moving is where it rises 0.05 above beta, which
        is a colour change of 9 of 255 levels. What moves was somewhere else before: both places
        count, as in the mask itself.
    """
    check_pair(truth, previous)
    if truth.dtype != np.uint8:
        raise MetricError(f"moving region: wanted uint8 in 0..255, got {truth.dtype}")
    return difference_mask(truth, previous, beta=BETA) > BETA + MOVING_ABOVE_BETA


def region_mask(truth: TruthFrame, region: Region) -> Mask | None:
    """Return the mask of a region.

    None in the first frame, where motion is undefined, and where masks are not known.
    """
    previous = truth.previous
    if region == "disoccluded":
        return truth.disoccluded
    if previous is None:
        return None
    moving = truth.once(moving_mask, lambda: moving_mask(truth.image, previous))
    return moving if region == "moving" else ~moving


class PartScorer:
    """A metric of one region; frames in which it is too small, or not known, have no value."""

    def __init__(
        self,
        name: str,
        region: Region,
        inside: Inside,
        options: MetricOptions,
        colour_map: ColourMap | None,
    ) -> None:
        self.names = (name,)
        self._region = region
        self._inside = inside
        self._options = options
        self._colour_map = colour_map
        self._previous: Image8 | None = None
        self._reason = (
            "no masks; run `ggvs-eval prepare`"
            if region == "disoccluded"
            else "motion needs 2 frames"
        )
        self._is_measured = False

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        pair = FramePair(
            index=index,
            rendered=rendered,
            truth=truth,
            previous=self._previous,
            options=self._options,
            colour_map=self._colour_map,
        )
        self._previous = rendered
        mask = region_mask(truth, self._region)
        if mask is None:
            return []
        try:
            value = self._inside(pair, mask)
        except (MetricError, WeightsError) as error:
            self._reason = str(error)
            return []
        if value is None:
            return []
        self._is_measured = True
        return [(self.names[0], index, value)]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        if not self._is_measured:
            raise MetricError(f"in no frame: {self._reason}")
        return []


class PairPartScorer(PartScorer):
    """A metric of pairs of neighbouring frames in one region, whose values belong to the first
    frame.
    """

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        return [
            (name, later - 1, value)
            for name, later, value in super().add(index, rendered, truth)
            if later is not None
        ]


def metric_of_part(metric: ViewMetric, region: Region) -> ViewMetric:
    """Return a metric that has an `inside`, of a region; the mask is computed once for all."""
    name, inside = f"{metric.name}_{region}", metric.inside
    if inside is None:
        raise MetricError(f"{metric.name} cannot be computed for a part of the image")
    return ViewMetric(
        name=name,
        kind=metric.kind,
        function=inside,
        unit=metric.unit,
        higher_is_better=metric.higher_is_better,
        group=REGION,
        describe=f"{metric.name} of {WORDS[region]}{metric.inside_note}",
        note=metric.note,
        reference="regions by the masks of Eq. 1",
        scorer=partial(
            _scorer, PairPartScorer if metric.kind == "pair" else PartScorer, name, region, inside
        ),
        weights=metric.weights,
        # of networks; windows of a part are compared on the CPU
        on_device=metric.on_device and metric.weights is not None,
        corrects_colours=metric.corrects_colours,
    )


def _scorer(
    kind: type[PartScorer],
    name: str,
    region: Region,
    inside: Inside,
    _names: Sequence[str],
    options: MetricOptions,
    colour_map: ColourMap | None,
) -> PartScorer:
    return kind(name, region, inside, options, colour_map)
