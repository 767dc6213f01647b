"""All metrics of one view in one pass, two instants in memory at most; what the truth alone decides is computed once."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.metrics import strred
from ggvs_eval.metrics.fetch_lpips import LpipsNet
from ggvs_eval.metrics.image import l1, psnr, psnr_colour_corrected, ssim
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.lpips import lpips_between, lpips_features
from ggvs_eval.metrics.registry import select_metrics
from ggvs_eval.metrics.temporal import sdt, temporal_change_ssim

if TYPE_CHECKING:
    import torch

Image8 = NDArray[np.uint8]
Value = tuple[str, int | None, float]  # metric, frame (None: the whole view), value


@dataclass(frozen=True)
class MetricOptions:
    """What a protocol may choose about the metrics.

    Attributes:
        lpips_net: network of LPIPS.
        sted_pairing: which frames ST-RRED compares, see `strred.strred`.
        ddof: 1 for unbiased standard deviations, 0 for plain ones.
    """

    lpips_net: LpipsNet = "vgg"
    sted_pairing: strred.Pairing = "disjoint"
    ddof: Literal[0, 1] = 1


@dataclass(frozen=True)
class ViewScores:
    """What could be measured on one view, and why the rest could not.

    Attributes:
        values: (metric, frame, value); the frame counts from 0, None stands for the whole view. The value of a pair of frames
            stands at its first frame. ``STED`` comes with its parts per pair, ``STED_spatial`` and ``STED_temporal``, whose
            means over any set of pairs multiply to the score of that set.
        not_computed: metric -> reason.
    """

    values: list[Value]
    not_computed: dict[str, str]


def score_view(
    pairs: Iterable[tuple[Image8, Image8]], metrics: Sequence[str], options: MetricOptions | None = None
) -> ViewScores:
    """Measure the rendered frames of one view against the captured ones.

    Args:
        pairs: rendered and true frame of each instant, in order, (H, W, 3) uint8; consumed as a stream.
        metrics: see `score_views`.
        options: see `score_views`.

    Returns:
        See `score_views`.
    """
    return score_views((((rendered,), truth) for rendered, truth in pairs), metrics, options)[0]


def score_views(
    frames: Iterable[tuple[Sequence[Image8], Image8]], metrics: Sequence[str], options: MetricOptions | None = None
) -> list[ViewScores]:
    """Measure several renderings of one view against the same captured frames.

    Args:
        frames: for each instant, in order, every method's frame and the true one, (H, W, 3) uint8; consumed as a stream.
        metrics: names out of `registry.METRICS`. Metrics of the whole rig (SDV) need every view and are passed over here:
            `views.sdv` computes them from the L1 values.
        options: variants of the metrics; the defaults where None.

    Returns:
        For each method, values of every frame, pair and the view. A metric that a view cannot have (too few frames, too small,
        no weights) is in `not_computed` with its reason, never NaN.

    Raises:
        MetricError: an unknown metric, no frames, or frames that do not fit each other.
    """
    options = options or MetricOptions()
    names = [spec.name for spec in select_metrics(metrics)]
    scores: list[ViewScores] = []
    scorers: list[list[_Scorer]] = []
    shape = None
    for index, (renderings, image) in enumerate(frames):
        shape = shape or image.shape
        if image.shape != shape:
            raise MetricError(f"frame {index} is {image.shape}, the frames before are {shape}; a view has one size")
        scores = scores or [ViewScores([], {}) for _ in renderings]
        scorers = scorers or [_make_scorers(names, options) for _ in renderings]
        truth = _Truth(image, options.lpips_net)
        for i, rendered in enumerate(renderings):
            check_pair(rendered, image)
            scorers[i] = [one for one in scorers[i] if _attempt(one, partial(one.add, index, rendered, truth), scores[i])]
    if shape is None:
        raise MetricError("no frames to score; render this view first")
    for remaining, view_scores in zip(scorers, scores, strict=True):
        for scorer in remaining:
            _attempt(scorer, scorer.finish, view_scores)
    return scores


class _Truth:
    """A captured frame with what the metrics derive from it alone, computed when first asked for."""

    def __init__(self, image: Image8, lpips_net: LpipsNet) -> None:
        self.image = image
        self._lpips_net = lpips_net

    @cached_property
    def lpips_features(self) -> "list[torch.Tensor]":
        return lpips_features(self.image, self._lpips_net)

    @cached_property
    def band(self) -> strred.Array:
        return strred.spatial_band(strred.luma(self.image))


class _Scorer(Protocol):
    """One or several metrics fed frame by frame."""

    @property
    def names(self) -> Sequence[str]:
        """The metrics it computes."""

    def add(self, index: int, rendered: Image8, truth: _Truth) -> list[Value]:
        """Take the next frame and return what it completes."""

    def finish(self) -> list[Value]:
        """Return what only the whole view has."""


def _attempt(scorer: _Scorer, measure: Callable[[], list[Value]], scores: ViewScores) -> bool:
    """Record the values, or the reason why there are none."""
    try:
        scores.values.extend(measure())
    except (MetricError, WeightsError) as error:
        scores.not_computed.update(dict.fromkeys(scorer.names, str(error)))
        return False
    return True


def _make_scorers(names: Sequence[str], options: MetricOptions) -> list[_Scorer]:
    measures: dict[str, Callable[[Image8, Image8], float]] = {
        "PSNR": psnr,
        "SSIM": ssim,
        "L1": l1,
        "PSNR_cc": psnr_colour_corrected,
    }
    scorers: list[_Scorer] = [_FrameScorer(name, measures[name]) for name in names if name in measures]
    if "LPIPS" in names:
        scorers.append(_LpipsScorer(options.lpips_net))
    if "TCC" in names:
        scorers.append(_ChangeScorer())
    if sted_names := [name for name in ("STED", "STED_ssn") if name in names]:
        scorers.append(_StredScorer(sted_names, options.sted_pairing))
    if "SDT" in names:
        scorers.append(_SpreadScorer(options.ddof))
    return scorers


class _FrameScorer:
    """A metric of single frames."""

    def __init__(self, name: str, measure: Callable[[Image8, Image8], float]) -> None:
        self.names = (name,)
        self._measure = measure

    def add(self, index: int, rendered: Image8, truth: _Truth) -> list[Value]:
        return [(self.names[0], index, self._measure(rendered, truth.image))]

    def finish(self) -> list[Value]:
        return []


class _LpipsScorer:
    """LPIPS; the truth's features are shared by all methods."""

    names = ("LPIPS",)

    def __init__(self, net: LpipsNet) -> None:
        self._net = net

    def add(self, index: int, rendered: Image8, truth: _Truth) -> list[Value]:
        theirs = truth.lpips_features
        return [("LPIPS", index, lpips_between(lpips_features(rendered, self._net), theirs, self._net))]

    def finish(self) -> list[Value]:
        return []


class _ChangeScorer:
    """TCC; keeps the frame before."""

    names = ("TCC",)

    def __init__(self) -> None:
        self._previous: tuple[Image8, Image8] | None = None
        self._pairs = 0

    def add(self, index: int, rendered: Image8, truth: _Truth) -> list[Value]:
        previous, self._previous = self._previous, (rendered, truth.image)
        if previous is None:
            return []
        self._pairs += 1
        return [("TCC", index - 1, temporal_change_ssim(previous[0], rendered, previous[1], truth.image))]

    def finish(self) -> list[Value]:
        _need_a_pair(self._pairs)
        return []


class _StredScorer:
    """STED and STED_ssn; keeps the bands of the frame before."""

    def __init__(self, names: Sequence[str], pairing: strred.Pairing) -> None:
        self.names = names
        self._pairing = pairing
        self._previous: tuple[strred.Array, strred.Array] | None = None
        self._differences: list[strred.PairDifference] = []

    def add(self, index: int, rendered: Image8, truth: _Truth) -> list[Value]:
        bands = strred.spatial_band(strred.luma(rendered)), truth.band
        previous, self._previous = self._previous, bands
        if previous is None or (self._pairing == "disjoint" and index % 2 == 0):
            return []
        references = (strred.reduced_references(a, b, self._pairing) for a, b in zip(previous, bands, strict=True))
        difference = strred.pair_difference(*references)
        self._differences.append(difference)
        parts = (("STED_spatial", difference.spatial), ("STED_temporal", difference.temporal))
        return [(name, index - 1, value) for name, value in parts if "STED" in self.names]

    def finish(self) -> list[Value]:
        _need_a_pair(len(self._differences))
        pooled = strred.pool(self._differences)
        scores = {"STED": pooled.strred, "STED_ssn": pooled.strred_ssn}
        return [(name, None, scores[name]) for name in self.names]


class _SpreadScorer:
    """SDT of this view; keeps one number per frame."""

    names = ("SDT",)

    def __init__(self, ddof: int) -> None:
        self._ddof = ddof
        self._errors: list[float] = []

    def add(self, index: int, rendered: Image8, truth: _Truth) -> list[Value]:
        self._errors.append(l1(rendered, truth.image))
        return []

    def finish(self) -> list[Value]:
        _need_a_pair(len(self._errors) - 1)
        return [("SDT", None, sdt([self._errors], self._ddof))]


def _need_a_pair(pairs: int) -> None:
    if pairs < 1:
        raise MetricError("1 frame; needs 2")
