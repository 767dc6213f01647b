"""Noise ceilings: rows of the report that belong to no method but give its numbers a scale."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.files.coding import Coding
from ggvs_eval.metrics.ceilings import ceilings
from ggvs_eval.metrics.registry import METRICS, ceiling_metrics
from ggvs_eval.pipelines.run.score_code import MEASURING
from ggvs_eval.pipelines.run.score_view import digest_frames, metric_options, truth_frames
from ggvs_eval.protocol import Measurement, Protocol
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json
from ggvs_eval.scoring import ScorePart, ScoreRequest
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.task import Task

NOISE_FREE, SECOND = "Ceiling: perfect and noise-free", "Ceiling: second recording"
NOTES = {
    NOISE_FREE: "estimated score of the scene without the camera's noise and codec against this "
    "capture.",
    SECOND: "estimated score of another recording by the same camera, with independent noise; a "
    "codec softens both alike.",
}
UNRECORDED = "not recorded in this run folder; prepare it again"


def plan_ceilings(request: ScoreRequest) -> ScorePart:
    """Plan the ceilings of a run's test views."""
    tasks = ceiling_tasks(request.run, request.protocol, request.views)
    return ScorePart(tasks=tuple(tasks), references=partial(reference_rows, tasks))


def ceiling_tasks(run: RunFolder, protocol: Protocol, views: Sequence[str]) -> list[Task]:
    """Return the tasks that estimate what perfect renderings of some test views would score, from
    their captured frames alone.

    Returns:
        One per test view; empty if the protocol wants none.
    """
    metrics = _wanted(protocol)
    if not metrics:
        return []
    frames = protocol.frames.numbers
    return [_task(run, view, frames, metrics, protocol.measurement) for view in views]


def _wanted(protocol: Protocol) -> list[str]:
    """Metrics of a protocol that perfect renderings are scored with.

    None if it wants no ceilings.
    """
    metrics = [name for name in ceiling_metrics() if name in protocol.measurement.metrics]
    return metrics if protocol.measurement.ceilings else []


def read_ceiling(run: RunFolder, protocol: Protocol, view: str) -> dict[str, Any] | None:
    """Read what a perfect rendering of a view scores.

    None if the protocol wants no ceilings, or there is none yet.

    Returns:
        ``noise_free`` and ``second_recording``, metric -> value, and ``not_computed``, metric ->
        reason.
    """
    file = run.ceilings(view) / JOB_FILE
    return read_json(file) if _wanted(protocol) and file.is_file() else None


def reference_rows(tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """Return the grey rows of the report: perfect renderings, and a second recording."""
    records = {task.folder.name: read_json(task.folder / JOB_FILE) for task in tasks}
    groups: dict[str, list[str]] = {}
    for name in ceiling_metrics():
        groups.setdefault(METRICS[name].group.key, []).append(name)
    return [
        {
            "group": group,
            "name": name,
            "note": NOTES[name],
            "values": _means(records, kind, metrics),
            "bounds": _bounds(records, kind, metrics),
        }
        for group, metrics in groups.items()
        for name, kind in ((NOISE_FREE, "noise_free"), (SECOND, "second_recording"))
        if records
    ]


def _means(
    records: Mapping[str, dict[str, Any]], kind: str, metrics: Sequence[str]
) -> dict[str, float | str]:
    """Return the mean over the views of each metric; the reason where one of them has none."""
    means: dict[str, float | str] = {}
    for metric in metrics:
        absent = {
            view: record["not_computed"] | record.get(f"no_{kind}", {})
            for view, record in records.items()
        }
        reasons = [
            f"{view}: {of_view[metric]}" for view, of_view in absent.items() if metric in of_view
        ]
        values = [record[kind][metric] for record in records.values() if metric in record[kind]]
        if reasons or values:
            means[metric] = reasons[0] if reasons else float(np.mean(values))
    return means


def _bounds(
    records: Mapping[str, dict[str, Any]], kind: str, metrics: Sequence[str]
) -> dict[str, str]:
    """Sides on which means are bounds, because one of the views has no more than a bound."""
    sides = (record.get(f"{kind}_bounds", {}) for record in records.values())
    return {name: side for of_view in sides for name, side in of_view.items() if name in metrics}


def _task(
    run: RunFolder, view: str, frames: range, metrics: Sequence[str], measurement: Measurement
) -> Task:
    coding = run.capture_record().get("coding", {}).get(view, {"unknown": UNRECORDED})
    inputs = {
        "truth": digest_frames(run.truth(view), frames),
        "coding": coding,
        "metrics": list(metrics),
        "measurement": [str(value) for value in vars(measurement).values()],
        "code": ceilings_code(metrics),
    }
    work = partial(_estimate, run, view, frames, metrics, measurement, coding and Coding(**coding))
    return Task(
        name=f"ceilings of {view}",
        folder=run.ceilings(view),
        inputs=inputs,
        make=work,
        kind="ceiling",
    )


def ceilings_code(names: Sequence[str]) -> str:
    """Return the hash of the code that estimates the ceilings of some metrics."""
    modules = [module for name in names for module in METRICS[name].modules]
    return code_of(ceilings.__module__, *MEASURING, *modules)


def _estimate(
    run: RunFolder,
    view: str,
    frames: range,
    metrics: Sequence[str],
    measurement: Measurement,
    coding: Coding | None,
    _folder: Path,
) -> dict[str, Any]:
    def captured() -> Iterator[Image8]:
        return truth_frames(run, view, frames, measurement)

    try:
        estimate = ceilings(captured, metrics, metric_options(measurement), coding=coding)
    except MetricError as error:
        return {
            "noise_free": {},
            "second_recording": {},
            "not_computed": dict.fromkeys(metrics, str(error)),
        }
    return {
        "noise_free": estimate.noise_free,
        "second_recording": estimate.second_recording,
        "not_computed": estimate.not_computed,
        "noise_free_bounds": estimate.bounds,
        "second_recording_bounds": estimate.second_bounds,
        "no_second_recording": dict.fromkeys(metrics, estimate.second_unknown)
        if estimate.second_unknown
        else {},
        "sigma_255": float(np.median(estimate.noise.sigma_255)),
        "averaged_share": estimate.averaged_share,
    }
