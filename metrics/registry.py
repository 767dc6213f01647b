"""The metrics by their names in protocols, tables and figures."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

from ggvs_eval import built_in
from ggvs_eval.errors import MetricError, did_you_mean
from ggvs_eval.metrics.metric import (
    ColourMap,
    DepthMetric,
    FrameScorer,
    Metric,
    MetricOptions,
    Row,
    Scorer,
    ScorerFactory,
    TableMetric,
    ViewMetric,
)
from ggvs_eval.plugins import Registry

Place = TypeVar("Place")


def _checked(name: str, metric: object) -> Metric:
    if not isinstance(metric, Metric) or isinstance(metric, DepthMetric):
        raise TypeError(
            f"wanted a ViewMetric, TableMetric or PathMetric, got {type(metric).__name__}"
        )
    if metric.name != name:
        raise TypeError(f"it calls itself {metric.name!r}")
    # what is wrong with them shows here
    metric.note(MetricOptions()), metric.pooling(MetricOptions()).record()
    return metric


def measured(
    names: Sequence[str], function: Callable[..., list[Place]], *arguments: Any
) -> list[Place]:
    """Return the values that the function of a metric gives.

    Those of a plug-in's come from another process.
    """
    values: list[Place] = (
        FOREIGN["values"](names, *arguments) if METRICS.origins(names) else function(*arguments)
    )
    return values


def _not_installed(name: str, reason: str) -> Metric:
    """Substitute for a metric whose package is missing: it is not computed and gives the reason."""

    def refuse(*_: object) -> float:
        raise MetricError(reason)

    return ViewMetric(
        name=name,
        kind="frame",
        function=refuse,
        higher_is_better=True,
        describe=reason,
        reference="",
    )


METRICS: Registry[Metric] = Registry(
    "metrics", {**built_in.VIEW_METRICS, **built_in.PATH_METRICS}, _checked, absent=_not_installed
)
FOREIGN: Registry[Any] = Registry("metrics of plug-ins", built_in.FOREIGN_METRICS)
DEPTH_METRICS: Registry[DepthMetric] = Registry("metrics of depth", built_in.DEPTH_METRICS)


def _all_metrics() -> str:
    """Return the end of a message: the names of all metrics, variants by their endings alone."""
    names = [(name, *name.rpartition("_")) for name in METRICS]
    endings = dict.fromkeys(f"_{ending}" for _, base, _, ending in names if base in METRICS)
    plain = ", ".join(name for name, base, _, _ in names if base not in METRICS)
    return (
        f"; all are {plain}, and some of these with {', '.join(endings)}; --plugin FILE.py adds "
        "your own"
    )


def select_metrics(names: Iterable[str]) -> tuple[Metric, ...]:
    """Return the metrics of these names, in this order, and next to each the one that it is not to
    be read without.

    Example:
        >>> [metric.name for metric in select_metrics(["mTV", "PSNR"])]
        ['mTV', 'Sharpness', 'PSNR']

    Reading:
        Stability without reference is measured by the rendering's own change between images, and
        blur lowers that: mTV, mTV2, E_warp, reprojection, and the change of depth maps. Their
        sharpness is added even if no one asks for it. TCC, STED, Flicker, SDT and SDV compare with
        captured frames; EPI_coherence has its own, EPI_line_texture; switch_ratio is a ratio of
        changes, from which blur cancels; COLMAP and SGC find fewer matches in blurred images.
    """
    selected: dict[str, Metric] = {}
    requests = list(names)
    for name in requests:
        if name in DEPTH_METRICS:
            raise MetricError(
                f"{name} is of depth videos, a protocol is of frames; measure it by `ggvs-eval "
                f"steadiness --depth`"
            )
        if name not in METRICS and not METRICS.why_absent(name):
            raise MetricError(f"no metric {name!r}{did_you_mean(name, METRICS) or _all_metrics()}")
        selected[name] = METRICS[name]
        if (beside := METRICS[name].beside) and beside not in requests:
            selected[beside] = METRICS[beside]
    return tuple(selected.values())


def scored_by_view(names: Iterable[str]) -> tuple[ViewMetric, ...]:
    """Select the metrics that score the frames of a view: those asked for per view, and those that
    others are made of.
    """
    selection = select_metrics(names)
    view_names = {
        metric.part if isinstance(metric, TableMetric) else metric.name for metric in selection
    }
    candidates = (METRICS[name] for name in METRICS.known() if name in view_names)
    return tuple(metric for metric in candidates if isinstance(metric, ViewMetric))


def make_scorers(
    metrics: Sequence[ViewMetric], options: MetricOptions, colour_map: ColourMap | None
) -> list[Scorer]:
    """Return one scorer, or one for several metrics that share work, for the metrics of a view.

    Args:
        metrics: see `scored_by_view`.
    """
    together: dict[ScorerFactory, list[str]] = {}
    for metric in metrics:
        together.setdefault(scorer_factory(metric), []).append(metric.name)
    scorers = []
    for factory, names in together.items():
        make = FOREIGN["scorer"] if METRICS.origins(names) else factory
        scorers.append(make(names, options, colour_map))
    return scorers


def scorer_factory(metric: ViewMetric) -> ScorerFactory:
    """Return what makes the scorer of a metric."""
    return metric.scorer or partial(_frame_scorer, metric.function)


def _frame_scorer(
    function: Callable[..., float],
    names: Sequence[str],
    _options: MetricOptions,
    _colour_map: ColourMap | None,
) -> Scorer:
    return FrameScorer(names[0], function)


def derived_rows(
    metrics: Iterable[Metric],
    values: Mapping[str, Mapping[str, Mapping[int, float]]],
    options: MetricOptions,
) -> tuple[dict[str, list[Row]], dict[str, str]]:
    """Return the values of those metrics that are made of other metrics' values.

    Args:
        values: metric -> view -> frame -> value.

    Returns:
        Metric -> values, and metric -> reason why there are none.
    """
    rows: dict[str, list[Row]] = {}
    reasons: dict[str, str] = {}
    for metric in metrics:
        if isinstance(metric, TableMetric):
            try:
                rows[metric.name] = measured(
                    [metric.name], metric.rows, values.get(metric.part, {}), options
                )
            except MetricError as error:
                reasons[metric.name] = str(error)
    return rows, reasons


def metric_notes(
    names: Iterable[str], options: MetricOptions | None = None
) -> dict[str, dict[str, Any]]:
    """Describe the metrics of these names, see `select_metrics`, as `describe_metrics` does."""
    return describe_metrics(select_metrics(names), options)


def describe_metrics(
    metrics: Iterable[Metric], options: MetricOptions | None = None
) -> dict[str, dict[str, Any]]:
    """Describe metrics for a report, as JSON values: reports read run folders and import no
    metric.
    """
    options = options or MetricOptions()
    return {
        metric.name: {
            "unit": metric.unit,
            "higher_is_better": metric.higher_is_better,
            "describe": f"{metric.describe}{metric.note(options)}",
            "reference": metric.reference,
            "group": metric.group.key,
            "group_title": metric.group.title,
            "decimals": metric.decimals,
        }
        for metric in metrics
    }


def pooling_records(names: Iterable[str], options: MetricOptions) -> dict[str, dict[str, Any]]:
    """Describe how each metric is pooled over views and frames, as JSON values that the results
    carry.
    """
    return {metric.name: metric.pooling(options).record() for metric in select_metrics(names)}


def ceiling_metrics() -> tuple[str, ...]:
    """Return the metrics that perfect renderings are scored with."""
    return built_in.METRICS_WITH_CEILING
