"""All metrics of a video, or of a depth video, that want no truth and no cameras, in one pass."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

from ggvs_eval.arrays import Image8, Map, Mask
from ggvs_eval.built_in import METRICS_OF_VIDEOS
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.metric import Series, Value, ViewMetric
from ggvs_eval.metrics.registry import DEPTH_METRICS, METRICS
from ggvs_eval.metrics.stream import ViewScores


def series_of_frames() -> dict[str, Series]:
    """Return the metrics of a video without truth."""
    metrics = {name: METRICS[name] for name in METRICS_OF_VIDEOS}
    return {
        name: metric.series
        for name, metric in metrics.items()
        if isinstance(metric, ViewMetric) and metric.series
    }


def series_of_depths() -> dict[str, Series]:
    """Return the metrics of a depth video."""
    return {name: metric.series for name, metric in DEPTH_METRICS.items()}


def score_frames(frames: Iterable[Image8], static: Mask | None = None) -> ViewScores:
    """Measure how steady a video is: mTV, mTV2, and the sharpness that they are to be read with.

    Args:
        frames: in order, each (H, W, 3) uint8 in 0..255 or float in [0, 1]; consumed as a stream,
            three are in memory.
        static: (H, W), where the scene is static and the camera with it; None for the whole image.

    Returns:
        (metric, first frame of those it belongs to, value), and the reasons for what there is too
        little of.

    Raises:
        MetricError: no frames, or frames that do not fit each other or the mask.

    Example:
        >>> import numpy as np
        >>> scores = score_frames([np.full((16, 16, 3), level, np.uint8) for level in (0, 51)])
        >>> scores.values
        [('Sharpness', 0, 0.0), ('mTV', 0, 20.0), ('Sharpness', 1, 0.0)]
        >>> scores.not_computed
        {'mTV2': '2 frames; needs 3'}
    """
    return _score(frames, static, series_of_frames())


def score_depths(depths: Iterable[Map], static: Mask | None = None) -> ViewScores:
    """Measure how steady a depth video is: change, second difference and holes of it, and its
    sharpness.

    Args:
        depths: in order, each (H, W) float, any unit, 0 = unknown; depth or disparity; consumed as
            a stream, three are in memory.
        static: see `score_frames`.

    Raises:
        MetricError: no depth maps, or maps that do not fit each other or the mask.

    Example:
        >>> import numpy as np
        >>> wall = np.full((8, 8), 2.0, np.float32)
        >>> [
        ...     (name, round(value, 2))
        ...     for name, _, value in score_depths([wall, 1.02 * wall]).values
        ...     if name == "depth_mTV"
        ... ]
        [('depth_mTV', 1.98)]
    """
    return _score(depths, static, series_of_depths())


def mean_values(scores: ViewScores) -> dict[str, float]:
    """Return the mean of each metric over the frames that have it, as metric -> value."""
    values: dict[str, list[float]] = {}
    for name, _, value in scores.values:
        values.setdefault(name, []).append(value)
    return {name: sum(series) / len(series) for name, series in values.items()}


def _score(frames: Iterable[Any], static: Mask | None, metrics: Mapping[str, Series]) -> ViewScores:
    """Slide over the frames and measure each metric on as many neighbours as it takes."""
    window: deque[Any] = deque(maxlen=max(series.n_frames for series in metrics.values()))
    values: list[Value] = []
    index = -1
    for index, frame in enumerate(frames):
        window.append(frame)
        for name, series in metrics.items():
            first = index + 1 - series.n_frames
            if first >= 0:
                values.append(
                    (name, first, series.function(list(window)[-series.n_frames :], static))
                )
    if index < 0:
        raise MetricError("no frames to score; wanted at least one")
    missing = {
        name: series.n_frames for name, series in metrics.items() if series.n_frames > index + 1
    }
    return ViewScores(
        values, {name: f"{index + 1} frames; needs {least}" for name, least in missing.items()}
    )
