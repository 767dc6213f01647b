"""All metrics of a rendered camera path in one pass; the path needs no truth."""

import tempfile
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.built_in import PATH_METRICS
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathPose, PathScorer, RenderedPath
from ggvs_eval.metrics.registry import METRICS, measured


@dataclass(frozen=True)
class PathScores:
    """Scores of a path, and the reasons for those that could not be computed.

    Attributes:
        values: (measure, pose, value). The whole path has pose None; ``reprojection`` and
            ``reprojection_visible`` come for every step too, at its first pose, counted from 0.
        not_computed: measure -> reason.
        rows: image rows that EPIs were taken from.
        n_switches: steps at which the source cameras change; None if the switch score was not
            computed.
    """

    values: list[Value]
    not_computed: dict[str, str]
    rows: tuple[int, ...]
    n_switches: int | None


def score_path(poses: Iterable[PathPose], metrics: Collection[str] = ()) -> PathScores:
    """Measure the view consistency of images along a camera path.

    Args:
        poses: in order; consumed as a stream. Two poses and `n_rows` rows of each are in memory.
        metrics: names of those that take seconds and are measured only where they are named; all
            others always are.

    Returns:
        Coherence and slope agreement of the EPIs, reprojection error and switch score. A measure
        that the path cannot have (no depth, no switch, not horizontal) is in `not_computed` with
        its reason, never NaN.

    Raises:
        MetricError: no poses, or images that do not fit their cameras.

    Example:
        >>> import numpy as np
        >>> from ggvs_eval.camera import Camera
        >>> camera = Camera(
        ...     "path0000", np.diag([50.0, 50.0, 1.0]), np.eye(4), 64, 48, near=1.0, far=9.0
        ... )
        >>> scores = score_path([PathPose(camera, np.zeros((48, 64, 3), np.uint8))] * 2)
        >>> scores.not_computed["EPI_coherence"]
        'an epipolar plane image wants at least 5 poses, the path has 2; add poses'
    """
    scorers = dict.fromkeys(metric.scorer for metric in measured_on_path(metrics))
    with tempfile.TemporaryDirectory(prefix="ggvs-path-") as folder:
        path = RenderedPath(
            Path(folder) if any(scorer.wants_images for scorer in scorers) else None
        )
        for pose in poses:
            path.add(pose)
        if not path.cameras:
            raise MetricError("no poses to score; render the camera path first")
        return _measured(path, scorers)


def measured_on_path(names: Collection[str]) -> list[PathMetric]:
    """List the metrics of a path that are measured: those that take no time, and of the others
    those that are named.
    """
    shipped = [METRICS[name] for name in PATH_METRICS if METRICS.is_present(name)]
    candidates = [*shipped, *(METRICS[name] for name in names if name not in PATH_METRICS)]
    of_paths = [metric for metric in candidates if isinstance(metric, PathMetric)]
    return [metric for metric in of_paths if metric.name in names or not metric.scorer.wants_images]


def _measured(path: RenderedPath, scorers: Iterable[PathScorer]) -> PathScores:
    values: list[Value] = []
    not_computed: dict[str, str] = {}
    for scorer in scorers:
        try:
            values_of_path = measured(scorer.names, scorer.measure, path)
        except MetricError as error:
            not_computed.update(dict.fromkeys(scorer.names, str(error)))
            continue
        values += values_of_path
        absent = [
            name
            for name in scorer.names
            if name not in {measure for measure, _, _ in values_of_path}
        ]
        not_computed.update(dict.fromkeys(absent, scorer.why_absent))
    return PathScores(
        values=values, not_computed=not_computed, rows=tuple(path.rows), n_switches=path.n_switches
    )
