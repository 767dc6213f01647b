"""All metrics of one view in one pass, two instants in memory at most.

Work on the truth alone is done once.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.metrics.colour_moments import ColourMoments
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.metric import ColourMap, Metric, MetricOptions, Scorer, TruthFrame, Value
from ggvs_eval.metrics.registry import derived_rows, make_scorers, scored_by_view, select_metrics


@dataclass(frozen=True)
class ViewScores:
    """Scores of a view, and the reasons for those that could not be computed.

    Attributes:
        values: (metric, frame, value); the frame counts from 0, None represents the whole view. The
            value of a pair of frames belongs to its first frame. ``STED`` comes with its parts per
            pair, ``STED_spatial`` and ``STED_temporal``, whose means over any set of pairs multiply
            to the score of that set; so it is for ``STED_ssn``.
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
        pairs: rendered and true frame of each instant, in order, (H, W, 3) uint8; consumed as a
            stream.
        metrics: see `score_views`.
        options: see `score_views`.
        colour_map: see `score_views`.
        disoccluded: see `score_views`.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> score_view(
        ...     [(truth + 5, truth), (truth + 7, truth)], ["L1", "SDT"], MetricOptions(ddof=0)
        ... ).values
        [('L1', 0, 5.0), ('L1', 1, 7.0), ('SDT', None, 1.0)]
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
        frames: for each instant, in order, every method's frame and the true one, (H, W, 3) uint8;
            consumed as a stream.
        metrics: names out of `registry.METRICS`. Metrics of the whole rig (SDV) and of camera paths
            are passed over here.
        options: variants of the metrics; the defaults where None.
        colour_maps: each method's map of this view, see `fit_colour_maps`; needed where colours are
            corrected per view.
        disoccluded: for each instant, where no source camera sees the view, (H, W); None if that is
            unknown.

    Returns:
        values of each method: by frame, by pair and of the view. A metric that a view cannot have
        (too few frames, too small, no weights) is in `not_computed` with its reason, never NaN.

    Raises:
        MetricError: an unknown metric, no frames, frames that do not fit each other, or no colour
            maps where they are needed.
    """
    options = options or MetricOptions()
    selection, streamed = select_metrics(metrics), scored_by_view(metrics)
    corrected = [metric.name for metric in streamed if metric.corrects_colours]
    if options.colour_scope == "view" and colour_maps is None and corrected:
        raise MetricError(
            f"{', '.join(corrected)}: colours are corrected per view; fit the maps first"
        )
    previous: Image8 | None = None
    scores: list[ViewScores] = []
    scorers: list[list[Scorer]] = []
    masks = iter(disoccluded) if disoccluded is not None else None
    for index, (renderings, image) in enumerate(frames):
        if previous is not None and image.shape != previous.shape:
            raise MetricError(
                f"frame {index} is {image.shape}, the frames before are {previous.shape}; a view "
                f"has one size"
            )
        if previous is None:
            scores = [ViewScores([], {}) for _ in renderings]
            per_view = (
                colour_maps
                if options.colour_scope == "view" and colour_maps
                else [None] * len(renderings)
            )
            scorers = [make_scorers(streamed, options, colour_map) for colour_map in per_view]
        truth = TruthFrame(
            image=image,
            previous=previous,
            disoccluded=next(masks) if masks else None,
            renderings=renderings,
        )
        previous = image
        for i, rendered in enumerate(renderings):
            check_pair(rendered, image)
            scorers[i] = [
                scorer
                for scorer in scorers[i]
                if _attempt(scorer, partial(scorer.add, index, rendered, truth), scores[i])
            ]
    if previous is None:
        raise MetricError("no frames to score; render this view first")
    for remaining, view_scores in zip(scorers, scores, strict=True):
        for scorer in remaining:
            _attempt(scorer, scorer.finish, view_scores)
    hidden = {metric.name for metric in streamed} - {metric.name for metric in selection}
    return [_with_derived(view_scores, selection, hidden, options) for view_scores in scores]


def fit_colour_maps(frames: Iterable[tuple[Sequence[Image8], Image8]]) -> list[ColourMap]:
    """Return each method's affine colour map of one view.

    Args:
        frames: as for `score_views`; consumed as a stream.
    """
    moments: list[ColourMoments] = []
    for renderings, image in frames:
        moments = moments or [ColourMoments() for _ in renderings]
        for colour_moments, rendered in zip(moments, renderings, strict=True):
            colour_moments.add(rendered, image)
    if not moments:
        raise MetricError("no frames to fit colours to; render this view first")
    return [colour_moments.map() for colour_moments in moments]


def _with_derived(
    scores: ViewScores, selection: Sequence[Metric], hidden: Collection[str], options: MetricOptions
) -> ViewScores:
    """Return the scores with what one view's other values decide, and without what was measured for
    that alone.
    """
    values: dict[str, dict[str, dict[int, float]]] = {}
    for name, frame, value in scores.values:
        if frame is not None:
            values.setdefault(name, {"": {}})[""][frame] = value
    rows, reasons = derived_rows(
        [metric for metric in selection if metric.kind == "view"], values, options
    )
    cells = [score for score in scores.values if score[0] not in hidden]
    cells += [(name, None, value) for name, of_view in rows.items() for _, _, value in of_view]
    return ViewScores(
        cells,
        {
            name: reason
            for name, reason in (scores.not_computed | reasons).items()
            if name not in hidden
        },
    )


def _attempt(scorer: Scorer, measure: Callable[[], list[Value]], scores: ViewScores) -> bool:
    try:
        scores.values.extend(measure())
    except (MetricError, WeightsError) as error:
        scores.not_computed.update(dict.fromkeys(scorer.names, str(error)))
        scores.values[:] = [value for value in scores.values if value[0] not in scorer.names]
        return False
    return True
