"""All metrics of one view in one pass, two instants in memory at most; what the truth alone decides is computed once."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.metrics.image.colour_correction import ColourMap, ColourMoments
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.registry import select_metrics
from ggvs_eval.metrics.scorers import CORRECTED, MetricOptions, make_scorers
from ggvs_eval.metrics.truth_frame import Scorer, TruthFrame, Value


@dataclass(frozen=True)
class ViewScores:
    """What could be measured on one view, and why the rest could not.

    Attributes:
        values: (metric, frame, value); the frame counts from 0, None stands for the whole view. The value of a pair of frames
            stands at its first frame. ``STED`` comes with its parts per pair, ``STED_spatial`` and ``STED_temporal``, whose
            means over any set of pairs multiply to the score of that set; ``STED_ssn`` likewise.
        not_computed: metric -> reason.
    """

    values: list[Value]
    not_computed: dict[str, str]


def score_view(
    pairs: Iterable[tuple[Image8, Image8]],
    metrics: Sequence[str],
    options: MetricOptions | None = None,
    *,
    colour_map: ColourMap | None = None,
    disoccluded: Iterable[Mask] | None = None,
) -> ViewScores:
    """Measure the rendered frames of one view against the captured ones.

    Args:
        pairs: rendered and true frame of each instant, in order, (H, W, 3) uint8; consumed as a stream.
        metrics: see `score_views`.
        options: see `score_views`.
        colour_map: see `score_views`.
        disoccluded: see `score_views`.

    Returns:
        See `score_views`.
    """
    frames = (((rendered,), truth) for rendered, truth in pairs)
    maps = None if colour_map is None else [colour_map]
    return score_views(frames, metrics, options, colour_maps=maps, disoccluded=disoccluded)[0]


def score_views(
    frames: Iterable[tuple[Sequence[Image8], Image8]],
    metrics: Sequence[str],
    options: MetricOptions | None = None,
    *,
    colour_maps: Sequence[ColourMap] | None = None,
    disoccluded: Iterable[Mask] | None = None,
) -> list[ViewScores]:
    """Measure several renderings of one view against the same captured frames.

    Args:
        frames: for each instant, in order, every method's frame and the true one, (H, W, 3) uint8; consumed as a stream.
        metrics: names out of `registry.METRICS`. Metrics of the whole rig (SDV) and of camera paths are passed over here.
        options: variants of the metrics; the defaults where None.
        colour_maps: each method's map of this view, see `fit_colour_maps`; needed where colours are corrected per view.
        disoccluded: for each instant, where no source camera sees the view, (H, W); None where nobody knows.

    Returns:
        For each method, values of every frame, pair and the view. A metric that a view cannot have (too few frames, too small,
        no weights) is in `not_computed` with its reason, never NaN.

    Raises:
        MetricError: an unknown metric, no frames, frames that do not fit each other, or no colour maps where they are needed.
    """
    options = options or MetricOptions()
    names = [spec.name for spec in select_metrics(metrics)]
    if options.colour_scope == "view" and colour_maps is None and set(names) & set(CORRECTED):
        raise MetricError(f"{', '.join(set(names) & set(CORRECTED))}: colours are corrected per view; fit the maps first")
    scores: list[ViewScores] = []
    scorers: list[list[Scorer]] = []
    masks = iter(disoccluded) if disoccluded is not None else None
    previous: Image8 | None = None
    for index, (renderings, image) in enumerate(frames):
        if previous is not None and image.shape != previous.shape:
            raise MetricError(f"frame {index} is {image.shape}, the frames before are {previous.shape}; a view has one size")
        if previous is None:
            scores = [ViewScores([], {}) for _ in renderings]
            per_view = colour_maps if options.colour_scope == "view" and colour_maps else [None] * len(renderings)
            scorers = [make_scorers(names, options, colour_map) for colour_map in per_view]
        truth = TruthFrame(image, previous, next(masks) if masks else None, options.lpips_net)
        previous = image
        for i, rendered in enumerate(renderings):
            check_pair(rendered, image)
            scorers[i] = [one for one in scorers[i] if _attempt(one, partial(one.add, index, rendered, truth), scores[i])]
    if previous is None:
        raise MetricError("no frames to score; render this view first")
    for remaining, view_scores in zip(scorers, scores, strict=True):
        for scorer in remaining:
            _attempt(scorer, scorer.finish, view_scores)
    return scores


def fit_colour_maps(frames: Iterable[tuple[Sequence[Image8], Image8]]) -> list[ColourMap]:
    """Each method's affine colour map of one view.

    Args:
        frames: as for `score_views`; consumed as a stream.

    Raises:
        MetricError: no frames, or frames that do not fit each other.
    """
    moments: list[ColourMoments] = []
    for renderings, image in frames:
        moments = moments or [ColourMoments() for _ in renderings]
        for one, rendered in zip(moments, renderings, strict=True):
            one.add(rendered, image)
    if not moments:
        raise MetricError("no frames to fit colours to; render this view first")
    return [one.map() for one in moments]


def _attempt(scorer: Scorer, measure: Callable[[], list[Value]], scores: ViewScores) -> bool:
    """Record the values, or the reason why there are none."""
    try:
        scores.values.extend(measure())
    except (MetricError, WeightsError) as error:
        scores.not_computed.update(dict.fromkeys(scorer.names, str(error)))
        return False
    return True
