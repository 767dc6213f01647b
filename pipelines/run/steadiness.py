"""Stability of single videos and depth videos: no capture, no cameras, no run folder."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from ggvs_eval.arrays import Mask
from ggvs_eval.built_in import COLMAP_METRICS, METRICS_OF_VIDEOS
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import read_image
from ggvs_eval.files.listing import IMAGE_SUFFIXES, VIDEO_SUFFIXES, list_files
from ggvs_eval.metrics.metric import Metric
from ggvs_eval.metrics.registry import DEPTH_METRICS, METRICS, describe_metrics
from ggvs_eval.metrics.series_scores import mean_values, score_depths, score_frames
from ggvs_eval.renders.sequences import read_depths, read_frames
from ggvs_eval.renders.view_streams import ARRAY_SUFFIXES


@dataclass(frozen=True)
class Steadiness:
    """Measured videos.

    Attributes:
        metrics: metric -> how a report describes it, see `registry.describe_metrics`; the sharpness
            among them.
        values: video -> metric -> mean over its frames.
        not_computed: video -> metric -> reason.
        shapes: video -> how many frames of which size it has, in words.
    """

    metrics: Mapping[str, dict[str, Any]]
    values: dict[str, dict[str, float]]
    not_computed: dict[str, dict[str, str]]
    shapes: dict[str, str]


def measure_steadiness(
    videos: Mapping[str, Path],
    *,
    depth: bool = False,
    mask: Path | None = None,
    with_colmap: bool = False,
) -> Steadiness:
    """Measure each video, or depth video, without truth.

    Of a folder of views each view, and their mean.
    """
    static = None if mask is None else read_image(mask)[..., 0] > 127
    metrics: list[Metric] = (
        list(DEPTH_METRICS.values()) if depth else [METRICS[name] for name in METRICS_OF_VIDEOS]
    )
    metrics += [METRICS[name] for name in COLMAP_METRICS if with_colmap]
    steadiness = Steadiness(
        metrics=describe_metrics(metrics), values={}, not_computed={}, shapes={}
    )
    for name, path in videos.items():
        views = {name: path} if depth else _views(name, path)
        for view, video in views.items():
            values, reasons, steadiness.shapes[view] = _measured(video, depth, static)
            if with_colmap:
                _add_colmap(video, values, reasons)
            steadiness.values[view], steadiness.not_computed[view] = values, reasons
        if name not in views:
            numbers = [steadiness.values[view] for view in views]
            shared = [
                metric for metric in numbers[0] if all(metric in values for values in numbers)
            ]
            mean = f"{name}, mean of {len(views)} views"
            steadiness.values[mean] = {
                metric: fmean(values[metric] for values in numbers) for metric in shared
            }
            steadiness.not_computed[mean] = steadiness.not_computed[next(iter(views))]
            steadiness.shapes[mean] = steadiness.shapes[next(iter(views))]
    return steadiness


def _views(name: str, path: Path) -> dict[str, Path]:
    """Return the videos of a folder of views, as `score` takes it, by names.

    A folder of pictures is one video.
    """
    if not path.is_dir() or list_files(path, IMAGE_SUFFIXES):
        return {name: path}
    views = [
        *filter(Path.is_dir, path.iterdir()),
        *list_files(path, (*VIDEO_SUFFIXES, *ARRAY_SUFFIXES)),
    ]
    return {f"{name} {view.stem}": view for view in sorted(views)} or {name: path}


@dataclass
class _Counted:
    """Passes frames on, and knows how many there were and how large."""

    frames: Iterable[Any]
    count: int = 0
    size: tuple[int, int] = (0, 0)

    def __iter__(self) -> Iterator[Any]:
        for frame in self.frames:
            self.count, self.size = self.count + 1, (frame.shape[1], frame.shape[0])
            yield frame


def _measured(
    path: Path, depth: bool, static: Mask | None
) -> tuple[dict[str, float], dict[str, str], str]:
    """Return metric -> value, metric -> reason for its absence, and how many frames of which size
    there were.
    """
    counted = _Counted(read_depths(path) if depth else read_frames(path))
    try:
        scores = score_depths(counted, static) if depth else score_frames(counted, static)
    except MetricError as error:
        raise MetricError(
            f"{path}: frame {counted.count - 1}: {error}" if counted.count else f"{path}: {error}"
        ) from error
    return (
        mean_values(scores),
        dict(scores.not_computed),
        f"{counted.count} frames of {counted.size[0]} x {counted.size[1]}",
    )


def _add_colmap(path: Path, values: dict[str, float], reasons: dict[str, str]) -> None:
    try:
        solved = METRICS[COLMAP_METRICS[0]].function(read_frames(path))
    except MetricError as error:
        reasons |= dict.fromkeys(COLMAP_METRICS, str(error))
    else:
        values |= dict(
            zip(
                COLMAP_METRICS,
                (solved.registered, solved.track_length, solved.matches),
                strict=True,
            )
        )
