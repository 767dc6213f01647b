"""Metrics of a view over time, fed frame by frame; each keeps the frame before, or numbers, and no more."""

from collections.abc import Sequence

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.psnr import l1
from ggvs_eval.metrics.time import strred
from ggvs_eval.metrics.time.flicker import FlickerMeter
from ggvs_eval.metrics.time.tcc import sdt, temporal_change_ssim
from ggvs_eval.metrics.truth_frame import TruthFrame, Value


class ChangeScorer:
    """TCC; keeps the frame before."""

    names = ("TCC",)

    def __init__(self) -> None:
        self._previous: tuple[Image8, Image8] | None = None
        self._pairs = 0

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        previous, self._previous = self._previous, (rendered, truth.image)
        if previous is None:
            return []
        self._pairs += 1
        return [("TCC", index - 1, temporal_change_ssim(previous[0], rendered, previous[1], truth.image))]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        _need_a_pair(self._pairs)
        return []


class StredScorer:
    """STED and STED_ssn; keeps the bands of the frame before."""

    def __init__(self, names: Sequence[str], pairing: strred.Pairing, pooling: strred.Pooling) -> None:
        self.names = names
        self._pairing = pairing
        self._pooling = pooling
        self._previous: tuple[strred.Array, strred.Array] | None = None
        self._differences: list[strred.PairDifference] = []

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        bands = strred.spatial_band(strred.luma(rendered)), truth.band
        previous, self._previous = self._previous, bands
        if previous is None or (self._pairing == "disjoint" and index % 2 == 0):
            return []
        ours = strred.reduced_references(previous[0], bands[0], self._pairing)
        difference = strred.pair_difference(ours, truth.entropies(previous[1], self._pairing))
        self._differences.append(difference)
        parts = (
            ("STED", "_spatial", difference.spatial),
            ("STED", "_temporal", difference.temporal),
            ("STED_ssn", "_spatial", difference.spatial_single),
            ("STED_ssn", "_temporal", difference.temporal_single),
        )
        return [(name + part, index - 1, value) for name, part, value in parts if name in self.names]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        _need_a_pair(len(self._differences))
        pooled = strred.pool(self._differences, self._pooling)
        scores = {"STED": pooled.strred, "STED_ssn": pooled.strred_ssn}
        return [(name, None, scores[name]) for name in self.names]


class FlickerScorer:
    """Flicker beyond the captured change."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = names
        self._meter = FlickerMeter()

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        self._meter.add(rendered, truth.image)
        return []

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        measured = self._meter.finish()
        scores = {"Flicker": measured.error, "Flicker_excess": measured.excess}
        return [(name, None, scores[name]) for name in self.names]


class SpreadScorer:
    """SDT of this view; keeps one number per frame."""

    names = ("SDT",)

    def __init__(self, ddof: int) -> None:
        self._ddof = ddof
        self._errors: list[float] = []

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        self._errors.append(l1(rendered, truth.image))
        return []

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        _need_a_pair(len(self._errors) - 1)
        return [("SDT", None, sdt([self._errors], self._ddof))]


def _need_a_pair(pairs: int) -> None:
    if pairs < 1:
        raise MetricError("1 frame; needs 2")
