"""Rows that belong to no method but give its numbers a scale: noise ceilings, and the captured images along a path."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.errors import MetricError
from ggvs_eval.jobs.job import Job
from ggvs_eval.metrics.ceilings import ceilings
from ggvs_eval.metrics.registry import METRICS, ceiling_metrics
from ggvs_eval.pipelines.run.score_code import ceilings_code
from ggvs_eval.pipelines.run.score_path import TRUTH
from ggvs_eval.pipelines.run.score_view import digest_frames, metric_options, truth_frames
from ggvs_eval.protocol import Measurement, Protocol
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json, write_json

NOISE_FREE, SECOND = "Ceiling: perfect and noise-free", "Ceiling: second recording"
NOTES = {
    NOISE_FREE: "estimate of what the scene without the camera's noise would score against this capture.",
    SECOND: "estimate of what another recording by the same camera, with noise of its own, would score.",
}
PATH_NOTE = "what a camera on the path would have seen, measured like the methods."


def ceiling_jobs(run: RunFolder, protocol: Protocol) -> list[Job]:
    """The jobs that estimate what perfect renderings of each test view would score, from its captured frames alone.

    Returns:
        One per test view; empty where the protocol wants none.
    """
    wanted = [name for name in ceiling_metrics() if name in protocol.measurement.metrics]
    if not protocol.measurement.ceilings or not wanted:
        return []
    frames = protocol.frames.numbers
    return [_job(run, view, frames, wanted, protocol.measurement) for view in protocol.views.test]


def read_ceilings(jobs: Sequence[Job]) -> dict[str, dict[str, Any]]:
    """What `ceiling_jobs` have found.

    Returns:
        view -> ``noise_free`` and ``second_recording``, metric -> value, and ``not_computed``, metric -> reason.
    """
    return {job.folder.name: read_json(job.folder / JOB_FILE) for job in jobs}


def write_references(run: RunFolder, paths: Mapping[str, dict[str, Any]], found: Mapping[str, dict[str, Any]]) -> None:
    """Write ``references.json``, which the report shows as grey rows.

    Args:
        run: the run folder.
        paths: see `score_path.read_paths`.
        found: see `read_ceilings`.
    """
    groups: dict[str, list[str]] = {}
    for name in ceiling_metrics():
        groups.setdefault(METRICS[name].group.key, []).append(name)
    entries = [
        {"group": group, "name": name, "note": NOTES[name], "values": _means(found, kind, metrics)}
        for group, metrics in groups.items()
        for name, kind in ((NOISE_FREE, "noise_free"), (SECOND, "second_recording"))
        if found
    ]
    if TRUTH in paths:
        values = {name: value for name, pose, value in paths[TRUTH]["values"] if pose < 0} | paths[TRUTH]["not_computed"]
        entries.append({"group": "path", "name": "Captured images", "note": PATH_NOTE, "values": values})
    write_json(run.root / "references.json", entries)


def _means(found: Mapping[str, dict[str, Any]], kind: str, metrics: Sequence[str]) -> dict[str, float | str]:
    """Mean over the views of each metric; the reason where one of them has none."""
    means: dict[str, float | str] = {}
    for metric in metrics:
        reasons = [
            f"{view}: {record['not_computed'][metric]}" for view, record in found.items() if metric in record["not_computed"]
        ]
        values = [record[kind][metric] for record in found.values() if metric in record[kind]]
        if reasons or values:
            means[metric] = reasons[0] if reasons else float(np.mean(values))
    return means


def _job(run: RunFolder, view: str, frames: range, metrics: Sequence[str], measurement: Measurement) -> Job:
    identity = {
        "truth": digest_frames(run.truth(view), frames),
        "metrics": list(metrics),
        "measurement": [str(value) for value in vars(measurement).values()],
        "code": ceilings_code(metrics),
    }
    return Job(f"ceilings of {view}", run.ceilings(view), identity, partial(_estimate, run, view, frames, metrics, measurement))


def _estimate(
    run: RunFolder, view: str, frames: range, metrics: Sequence[str], measurement: Measurement, _folder: Path
) -> dict[str, Any]:
    try:
        found = ceilings(lambda: truth_frames(run, view, frames, measurement), metrics, metric_options(measurement))
    except MetricError as error:
        return {"noise_free": {}, "second_recording": {}, "not_computed": dict.fromkeys(metrics, str(error))}
    return {
        "noise_free": found.noise_free,
        "second_recording": found.second_recording,
        "not_computed": found.not_computed,
        "sigma_255": float(np.median(found.noise.sigma_255)),
        "averaged_share": found.averaged_share,
    }
