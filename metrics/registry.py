"""The metrics by their names in protocols, tables and figures."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from math import isnan
from numbers import Real
from typing import Any

from ggvs_eval.arrays import Image8, read_only
from ggvs_eval.errors import MetricError, did_you_mean
from ggvs_eval.metrics.image.corrected import LPIPS_CC, PSNR_CC, SSIM_CC
from ggvs_eval.metrics.image.dists import DISTS
from ggvs_eval.metrics.image.dssim import DSSIM1, DSSIM2
from ggvs_eval.metrics.image.flip import FLIP
from ggvs_eval.metrics.image.iv_psnr import IV_PSNR, PSNR_YCBCR
from ggvs_eval.metrics.image.l1 import L1
from ggvs_eval.metrics.image.lpips import LPIPS
from ggvs_eval.metrics.image.ms_ssim import MS_SSIM
from ggvs_eval.metrics.image.psnr import PSNR
from ggvs_eval.metrics.image.regions import metrics_of_parts
from ggvs_eval.metrics.image.sharpness import SHARPNESS
from ggvs_eval.metrics.image.ssim_variants import SSIM
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
    TruthFrame,
    Value,
    ViewMetric,
)
from ggvs_eval.metrics.path.colmap_consistency import COLMAP_MATCHES, COLMAP_REGISTERED, COLMAP_TRACK_LENGTH
from ggvs_eval.metrics.path.epi_coherence import EPI_COHERENCE, EPI_LINE_TEXTURE
from ggvs_eval.metrics.path.epi_slope import EPI_SLOPE_AGREEING, EPI_SLOPE_ERROR
from ggvs_eval.metrics.path.reprojection import REPROJECTION, REPROJECTION_VISIBLE
from ggvs_eval.metrics.path.spatial_consistency import SGC_ROTATION, SGC_TRANSLATION
from ggvs_eval.metrics.path.view_switch import SWITCH_EXCESS, SWITCH_RATIO
from ggvs_eval.metrics.path.warping_error import E_WARP, PATH_SHARPNESS
from ggvs_eval.metrics.time.colour_video_vdp import CVVDP
from ggvs_eval.metrics.time.depth_variation import DEPTH_BLINKING, DEPTH_MTV, DEPTH_MTV2, DEPTH_SHARPNESS
from ggvs_eval.metrics.time.deviations import SDT, SDV
from ggvs_eval.metrics.time.flicker import FLICKER, FLICKER_EXCESS
from ggvs_eval.metrics.time.on_screen import ScreenMetric, metrics_on_screen
from ggvs_eval.metrics.time.strred import STED, STED_SSN
from ggvs_eval.metrics.time.tcc import TCC
from ggvs_eval.metrics.time.temporal_variation import MTV, MTV2
from ggvs_eval.metrics.time.vmaf import VMAF
from ggvs_eval.plugins import Registry, foreign

# In the order in which they are scored and listed in the results.
_OF_IMAGES = (PSNR, SSIM, L1, LPIPS, PSNR_CC, SSIM_CC, LPIPS_CC, IV_PSNR, PSNR_YCBCR, MS_SSIM, DSSIM1, DSSIM2, FLIP, DISTS)
_ALL: tuple[Metric, ...] = (
    *_OF_IMAGES,
    *metrics_of_parts((*_OF_IMAGES, TCC)),
    *(TCC, STED, STED_SSN, FLICKER, FLICKER_EXCESS, SDT, SDV),
    *(*VMAF, CVVDP),
    *metrics_on_screen((PSNR, SSIM, LPIPS, TCC, STED)),
    *(MTV, SHARPNESS, MTV2),
    *(EPI_COHERENCE, EPI_LINE_TEXTURE, EPI_SLOPE_ERROR, EPI_SLOPE_AGREEING),
    *(REPROJECTION, REPROJECTION_VISIBLE, E_WARP, PATH_SHARPNESS, SWITCH_RATIO, SWITCH_EXCESS),
    *(COLMAP_REGISTERED, COLMAP_TRACK_LENGTH, COLMAP_MATCHES, SGC_ROTATION, SGC_TRANSLATION),
)


def _checked(name: str, metric: object) -> Metric:
    if not isinstance(metric, Metric) or isinstance(metric, DepthMetric):
        raise TypeError(f"wanted a ViewMetric, TableMetric or PathMetric, got {type(metric).__name__}")
    if metric.name != name:
        raise TypeError(f"it calls itself {metric.name!r}")
    metric.note(MetricOptions()), metric.pooling(MetricOptions()).record()  # what is wrong with them shows here
    return metric


def measured(names: Sequence[str], measure: Callable[[], Iterable[tuple[Any, ...]]]) -> list[Any]:
    """Values of a metric, each behind its place; one of a plug-in that fails, or gives no number, is a `MetricError`."""
    origins = METRICS.origins(names)
    if not origins:
        return list(measure())
    with foreign(", ".join(f"{origin}: metric {name} failed" for name, origin in origins.items()), MetricError):
        return [(*place, _number(value)) for *place, value in measure()]


def _number(value: object) -> float:
    if not isinstance(value, Real):
        raise TypeError(f"wanted a number, got {type(value).__name__}")
    if isnan(value):
        raise ValueError("wanted a number, got nan")
    return float(value)


class ForeignScorer:
    """A scorer of a plug-in's metrics, see `measured`; it is shown arrays that it cannot write to."""

    def __init__(self, names: Sequence[str], make: Callable[[], Scorer]) -> None:
        self.names = names
        self._make = cache(make)

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        shown = truth.once(ForeignScorer, truth.read_only)
        return measured(self.names, lambda: self._make().add(index, read_only(rendered), shown))

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return measured(self.names, lambda: self._make().finish())


METRICS: Registry[Metric] = Registry("metrics", {metric.name: metric for metric in _ALL}, _checked)
DEPTH_METRICS: dict[str, DepthMetric] = {
    metric.name: metric for metric in (DEPTH_MTV, DEPTH_SHARPNESS, DEPTH_MTV2, DEPTH_BLINKING)
}


def select_metrics(names: Iterable[str]) -> tuple[Metric, ...]:
    """The metrics of these names, in this order, and next to each the one that it is not to be read without.

    Example:
        >>> [metric.name for metric in select_metrics(["mTV", "PSNR"])]
        ['mTV', 'Sharpness', 'PSNR']

    Reading:
        What is steady without truth is told from the rendering's own change from one image to the next, and blur lowers that:
        mTV, mTV2, E_warp, reprojection, and the change of depth maps. Their sharpness is added even if nobody asks for it. TCC,
        STED, Flicker, SDT and SDV compare with captured frames; EPI_coherence has its own, EPI_line_texture; switch_ratio is a
        ratio of changes, from which blur cancels; COLMAP and SGC find fewer matches in blurred images.
    """
    selected: dict[str, Metric] = {}
    asked = list(names)
    for name in asked:
        if name in DEPTH_METRICS:
            raise MetricError(f"{name} is of depth videos, a protocol is of frames; measure it by `ggvs-eval steadiness --depth`")
        if name not in METRICS:
            raise MetricError(f"no metric {name!r}{did_you_mean(name, METRICS) or '; all are ' + ', '.join(METRICS)}")
        selected[name] = METRICS[name]
        if (beside := METRICS[name].beside) and beside not in asked:
            selected[beside] = METRICS[beside]
    return tuple(selected.values())


def scored_by_view(names: Iterable[str]) -> tuple[ViewMetric, ...]:
    """Select the metrics that score the frames of a view: those asked for per view, and those that others are made of."""
    asked = select_metrics(names)
    view_names = {metric.part if isinstance(metric, TableMetric) else metric.name for metric in asked}
    chosen = (METRICS[name] for name in METRICS if name in view_names)
    return tuple(metric for metric in chosen if isinstance(metric, ViewMetric))


def scored_on_screen(names: Iterable[str]) -> tuple[ScreenMetric, ...]:
    """Select the metrics that are of what stands on the screen."""
    return tuple(metric for metric in select_metrics(names) if isinstance(metric, ScreenMetric))


def make_scorers(metrics: Sequence[ViewMetric], options: MetricOptions, colour_map: ColourMap | None) -> list[Scorer]:
    """One scorer, or one for several metrics that share work, for the metrics of a view.

    Args:
        metrics: see `scored_by_view`.
    """
    together: dict[ScorerFactory, list[str]] = {}
    for metric in metrics:
        together.setdefault(metric.scorer or partial(_frame_scorer, metric.function), []).append(metric.name)
    made = []
    for factory, names in together.items():
        make = partial(factory, names, options, colour_map)
        made.append(ForeignScorer(names, make) if METRICS.origins(names) else make())
    return made


def _frame_scorer(
    function: Callable[..., float], names: Sequence[str], _options: MetricOptions, _colour_map: ColourMap | None
) -> Scorer:
    return FrameScorer(names[0], function)


def derived_rows(
    metrics: Iterable[Metric], values: Mapping[str, Mapping[str, Mapping[int, float]]], options: MetricOptions
) -> tuple[dict[str, list[Row]], dict[str, str]]:
    """Values of those metrics that are made of other metrics' values.

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
                rows[metric.name] = measured([metric.name], partial(metric.rows, values.get(metric.part, {}), options))
            except MetricError as error:
                reasons[metric.name] = str(error)
    return rows, reasons


def metric_notes(names: Iterable[str], options: MetricOptions | None = None) -> dict[str, dict[str, Any]]:
    """Describe the metrics of these names, see `select_metrics`, as `describe_metrics` does."""
    return describe_metrics(select_metrics(names), options)


def describe_metrics(metrics: Iterable[Metric], options: MetricOptions | None = None) -> dict[str, dict[str, Any]]:
    """Describe metrics for a report, as JSON values: reports read run folders and import no metric."""
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
    """Describe how each metric is pooled over views and frames, as JSON values that the results carry."""
    return {metric.name: metric.pooling(options).record() for metric in select_metrics(names)}


def ceiling_metrics() -> tuple[str, ...]:
    """Metrics that perfect renderings are scored with."""
    return tuple(metric.name for metric in METRICS.shipped.values() if metric.has_ceiling)
