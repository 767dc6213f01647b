"""Metrics of a part of the image: what stands still, what moves, what no source camera sees."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.metric import REGION, ColourMap, FramePair, Inside, MetricOptions, TruthFrame, Value, ViewMetric

Region = Literal["static", "moving", "disoccluded"]
REGIONS: tuple[Region, ...] = get_args(Region)
WORDS: dict[Region, str] = {
    "static": "what stands still",
    "moving": "what moves",
    "disoccluded": "what no source camera sees",
}
# A change of colour by 9 of 255 levels at a quarter of the size, well above sensor noise averaged over 16 pixels.
MOVING_ABOVE_BETA = 0.05
BETA = 0.6


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


def region_mask(truth: TruthFrame, region: Region) -> Mask | None:
    """Return the mask of a region; None in the first frame, where motion is undefined, and where masks are not known."""
    previous = truth.previous
    if region == "disoccluded":
        return truth.disoccluded
    if previous is None:
        return None
    moving = truth.once(moving_mask, lambda: moving_mask(truth.image, previous))
    return moving if region == "moving" else ~moving


class RegionScorer:
    """Metrics of one region; frames in which it is too small, or not known, have no value."""

    def __init__(
        self, region: Region, parts: Mapping[str, ViewMetric], options: MetricOptions, colour_map: ColourMap | None
    ) -> None:
        self.names = list(parts)
        self._region = region
        self._parts = parts
        self._options = options
        self._colour_map = colour_map
        self._previous: Image8 | None = None
        self._reasons = {name: "no masks are known; run `ggvs-eval prepare`" for name in self.names}
        self._measured: set[str] = set()

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        pair = FramePair(index, rendered, truth, self._previous, self._options, self._colour_map)
        self._previous = rendered
        mask = region_mask(truth, self._region)
        if mask is None:
            return []
        values: list[Value] = []
        for name, metric in self._parts.items():
            value = self._value(name, metric, pair, mask)
            if value is not None:
                values.append((name, index - 1 if metric.kind == "pair" else index, value))
        self._measured |= {name for name, _, _ in values}
        return values

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        absent = [name for name in self.names if name not in self._measured]
        if absent:
            raise MetricError(f"{', '.join(absent)}: in no frame, {self._reasons[absent[0]]}")
        return []

    def _value(self, name: str, metric: ViewMetric, pair: FramePair, mask: Mask) -> float | None:
        inside = metric.inside
        try:
            return inside(pair, mask) if inside else None
        except (MetricError, WeightsError) as error:
            self._reasons[name] = str(error)
            return None


def metrics_of_parts(metrics: Iterable[ViewMetric]) -> tuple[ViewMetric, ...]:
    """Each metric that has an `inside`, of each region; those of one region share its mask."""
    whole = [metric for metric in metrics if metric.inside]
    return tuple(part for region in REGIONS for part in _metrics_of(region, whole))


def _metrics_of(region: Region, whole: Sequence[ViewMetric]) -> Iterable[ViewMetric]:
    scorer = partial(_region_scorer, region, {f"{metric.name}_{region}": metric for metric in whole})
    for metric in whole:
        inside: Inside | None = metric.inside
        if inside is not None:
            yield ViewMetric(
                name=f"{metric.name}_{region}",
                kind=metric.kind,
                function=inside,
                unit=metric.unit,
                higher_is_better=metric.higher_is_better,
                group=REGION,
                describe=f"{metric.name} of {WORDS[region]}{metric.inside_note}",
                note=metric.note,
                reference="regions by the masks of Eq. 1",
                scorer=scorer,
                weights=metric.weights,
                corrects_colours=metric.corrects_colours,
            )


def _region_scorer(
    region: Region,
    parts: Mapping[str, ViewMetric],
    names: Sequence[str],
    options: MetricOptions,
    colour_map: ColourMap | None,
) -> RegionScorer:
    return RegionScorer(region, {name: parts[name] for name in parts if name in names}, options, colour_map)
