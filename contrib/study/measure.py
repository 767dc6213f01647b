"""Measure one series: a take under one ladder and seed, at every strength, by every metric that is
asked for.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.study.clips import Clip, Take
from ggvs_eval.contrib.study.ladders import OF_FRAMES, Ladder
from ggvs_eval.contrib.study.rendered_ladders import EXCHANGES, sources_at
from ggvs_eval.metrics.image.regions import REGION
from ggvs_eval.metrics.metric import Metric, MetricOptions, TableMetric, Value, ViewMetric
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathPose, RenderedPath
from ggvs_eval.metrics.path_scores import score_path
from ggvs_eval.metrics.registry import METRICS, derived_rows, scored_by_view, select_metrics
from ggvs_eval.metrics.stream import fit_colour_maps, score_view
from ggvs_eval.pipelines.run.score_code import metric_code
from ggvs_eval.pipelines.run.score_path import PATH_SCORES
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.task import Task

# 25 ms of a core or more for a frame of 224x168, where all others together take 12: these see the
# first view of a take, and where they are of single frames every `EVERY`th of them.
COSTLY = frozenset(
    {
        "LPIPS",
        "LPIPS_cc",
        "DISTS",
        "FLIP",
        "CVVDP",
        "COLMAP_registered",
        "COLMAP_track_length",
        "COLMAP_matches",
    }
    | {"SGC_rotation", "SGC_translation"}
)
EVERY = 6
UNDEGRADED = "none"  # represents all ladders of frames at strength 0
ALL = "all"
Numbers = dict[str, float]
Reasons = dict[str, str]


def absent_kinds(metrics: Sequence[str]) -> Reasons:
    """Reasons for metrics that no clip can have."""
    kinds = ViewMetric | TableMetric | PathMetric
    return {
        metric.name: f"it is of {metric.kind}, a clip has frames"
        for metric in select_metrics(metrics)
        if not isinstance(metric, kinds)
    }


def study_metrics(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the metrics of a study: those that are not costly by default, ``all``, or
    those that are named.

    Parts of an image (``PSNR_static``, ...) are measured where they are named.
    """
    named = [name for name in dict.fromkeys(names) if name != ALL]
    select_metrics(named)
    if named and ALL not in names:
        return tuple(named)
    usual = [name for name, metric in METRICS.built_in().items() if metric.group != REGION]
    return tuple(
        dict.fromkeys([*(name for name in usual if ALL in names or name not in COSTLY), *named])
    )


def series_tasks(
    out: Path, take: Take, ladder: Ladder | None, seed: int, metrics: Sequence[str]
) -> list[Task]:
    """Return what measures one series, a task per metric; they are done together.

    Args:
        ladder: how; None for the undegraded frames.
    """
    name = ladder.name if ladder else UNDEGRADED
    frames = {
        "take": take.digest,
        "ladder": code_of(ladder.module if ladder else OF_FRAMES),
        "strengths": list(strengths_of(ladder)),
        "seed": seed,
    }
    folder = out / "cells" / name / take.name.replace(", ", "/") / f"seed{seed}"
    return [
        Task(
            name=f"{name} in {take.name}",
            folder=folder / metric.name,
            inputs=frames | {"metric": _code(metric)},
            together=partial(_measure, take, ladder, seed),
            above=1,
        )
        for metric in select_metrics(metrics)
    ]


def strengths_of(ladder: Ladder | None) -> tuple[float, ...]:
    """Return the strengths that a series measures: ladders of frames have their undegraded frames
    in common.
    """
    if ladder is None:
        return (0.0,)
    return (0.0, *ladder.strengths) if ladder.is_rendered else ladder.strengths


def _code(metric: Metric) -> str:
    """Return the hash of the code that measures a metric.

    Of a path, one pass measures all that it has, and each counts alone.
    """
    if isinstance(metric, PathMetric):
        return code_of(PATH_SCORES, RenderedPath.__module__, *metric.modules)
    return metric_code(metric)


def _measure(
    take: Take, ladder: Ladder | None, seed: int, tasks: Sequence[Task]
) -> Iterator[tuple[Task, dict[str, Any]]]:
    metrics = tuple(task.folder.name for task in tasks)
    levels = [_at(take, ladder, strength, seed, metrics) for strength in strengths_of(ladder)]
    for task, metric in zip(tasks, metrics, strict=True):
        values = [numbers.get(metric) for numbers, _ in levels]
        yield (
            task,
            {"values": values, "not_computed": [reasons.get(metric) for _, reasons in levels]},
        )


def _at(
    take: Take, ladder: Ladder | None, strength: float, seed: int, metrics: Sequence[str]
) -> tuple[Numbers, Reasons]:
    clips = list(take.clips())
    # Each view has its own seed, of the parity of the clip's.
    frames = [
        ladder.frames(clip, strength, seed + 1000 * view) if ladder else clip.undegraded
        for view, clip in enumerate(clips)
    ]
    numbers, reasons = measure_views(clips, frames, metrics)
    paths, absent = _measure_paths(clips, frames, metrics, _sources(ladder, clips, strength, seed))
    return numbers | paths, reasons | absent | absent_kinds(metrics)


def measure_views(
    clips: Sequence[Clip], rendered: Sequence[Image8], metrics: Sequence[str]
) -> tuple[Numbers, Reasons]:
    """Measure the frames of some views against the true ones: each metric's number on them, or the
    reason for its absence.
    """
    selection = [
        metric for metric in select_metrics(metrics) if isinstance(metric, ViewMetric | TableMetric)
    ]
    usual = [metric.name for metric in selection if metric.name not in COSTLY]
    parts = [metric.part for metric in selection if isinstance(metric, TableMetric)]
    tables: dict[str, dict[str, dict[int, float]]] = {}
    numbers: dict[str, list[float]] = {}
    reasons: Reasons = {}
    for number, (clip, frames) in enumerate(zip(clips, rendered, strict=True)):
        costly = [metric.name for metric in selection if metric.name in COSTLY and not number]
        values, absent = _measure_view(clip.truth, frames, [*dict.fromkeys([*usual, *parts])])
        for name in costly:
            every = EVERY if METRICS[name].kind == "frame" else 1
            of_costly, why = _measure_view(clip.truth[::every], frames[::every], [name])
            values, absent = values + of_costly, absent | why
        for name, frame, value in values:
            if frame is not None:
                tables.setdefault(name, {}).setdefault(str(number), {})[frame] = value
        for metric in selection:
            if (pooled := _number(metric, values)) is not None:
                numbers.setdefault(metric.name, []).append(pooled)
        reasons |= {name: why for name, why in absent.items() if name in metrics}
    rows, absent = derived_rows(
        [metric for metric in selection if metric.kind == "rig"], tables, MetricOptions()
    )
    pooled_numbers = {name: float(np.mean(values)) for name, values in numbers.items()}
    of_rig = {
        name: float(np.mean([value for _, _, value in of_metric]))
        for name, of_metric in rows.items()
    }
    return pooled_numbers | of_rig, reasons | absent


def _measure_view(
    truth: Image8, rendered: Image8, names: Collection[str]
) -> tuple[list[Value], Reasons]:
    names = tuple(names)
    if not names:
        return [], {}
    colours = None
    if any(metric.corrects_colours for metric in scored_by_view(names)):
        (colours,) = fit_colour_maps(
            ((frame,), true) for frame, true in zip(rendered, truth, strict=True)
        )
    scores = score_view(zip(rendered, truth, strict=True), names, colour_map=colours)
    return scores.values, scores.not_computed


def _number(metric: Metric, values: Iterable[Value]) -> float | None:
    """Return a metric's number on one view: what its scorer says of the whole view, or what its
    frames pool to.
    """
    by_name: dict[str, list[float]] = {}
    for name, frame, value in values:
        if name == metric.name and frame is None:
            return value
        by_name.setdefault(name, []).append(value)
    pooling = metric.pooling(MetricOptions())
    parts = [
        np.array([by_name[name]]) for name in pooling.parts or (metric.name,) if name in by_name
    ]
    if metric.kind == "rig" or len(parts) < len(pooling.parts or (metric.name,)):
        return None
    frames = parts[0].shape[1]
    return float(pooling.pool(*parts)(np.ones((1, 1)), np.full((1, frames), 1 / frames))[0])


def _measure_paths(
    clips: Sequence[Clip],
    rendered: Sequence[Image8],
    metrics: Sequence[str],
    sources: Sequence[Sequence[tuple[str, ...]]],
) -> tuple[Numbers, Reasons]:
    names = [metric.name for metric in select_metrics(metrics) if isinstance(metric, PathMetric)]
    moving = [clip.moves for clip in clips]
    if not names or not any(moving):
        return {}, dict.fromkeys(names, "the camera is static")
    values: list[Value] = []
    reasons: Reasons = {}
    for clip, frames, of_frames in compress(zip(clips, rendered, sources, strict=True), moving):
        depths = [None] * len(frames) if clip.depths is None else clip.depths
        scores = score_path(map(PathPose, clip.cameras, frames, depths, of_frames), metrics=names)
        values += [value for value in scores.values if value[1] is None and value[0] in names]
        reasons |= {name: why for name, why in scores.not_computed.items() if name in names}
    numbers = {name: [value for metric, _, value in values if metric == name] for name in names}
    return {
        name: float(np.mean(of_paths)) for name, of_paths in numbers.items() if of_paths
    }, reasons


def _sources(
    ladder: Ladder | None, clips: Sequence[Clip], strength: float, seed: int
) -> list[list[tuple[str, ...]]]:
    """Return the names of the cameras that each frame of each clip is made of."""
    switches = {"switch": strength, "jump": EXCHANGES}.get(ladder.name if ladder else "")
    if switches is None:
        return [
            [tuple(source.camera.name for source in clip.sources)] * len(clip.truth)
            for clip in clips
        ]
    return [
        [
            tuple(
                source.camera.name
                for source in sources_at(clip, frame, switches, seed + 1000 * view)
            )
            for frame in range(len(clip.truth))
        ]
        for view, clip in enumerate(clips)
    ]
