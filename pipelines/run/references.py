"""Rows that belong to no method but give its numbers a scale: noise ceilings, and the captured images along a path."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.files.coding import Coding
from ggvs_eval.jobs.job import Job
from ggvs_eval.metrics.ceilings import ceilings
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.registry import METRICS, ceiling_metrics
from ggvs_eval.pipelines.inspection.finding import Finding
from ggvs_eval.pipelines.inspection.renders.examine import COMPARED, find_seen
from ggvs_eval.pipelines.inspection.renders.identity import views_of_run
from ggvs_eval.pipelines.run.score_code import ceilings_code
from ggvs_eval.pipelines.run.score_path import TRUTH
from ggvs_eval.pipelines.run.score_view import digest_frames, metric_options, truth_frames
from ggvs_eval.protocol import Measurement, Protocol
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json, write_json

NOISE_FREE, SECOND = "Ceiling: perfect and noise-free", "Ceiling: second recording"
NOTES = {
    NOISE_FREE: "estimated score of the scene without the camera's noise and codec against this capture.",
    SECOND: "estimated score of another recording by the same camera, with independent noise; a codec softens both alike.",
}
LEAST_DB = 30.0
UNRECORDED = "not recorded in this run folder; prepare it again"
PATH_NOTE = "ground truth of a camera on the path, measured like the methods."


def ceiling_jobs(run: RunFolder, protocol: Protocol, views: Sequence[str]) -> list[Job]:
    """Return the jobs that estimate what perfect renderings of some test views would score, from their captured frames alone.

    Returns:
        One per test view; empty if the protocol wants none.
    """
    metrics = [name for name in ceiling_metrics() if name in protocol.measurement.metrics]
    if not protocol.measurement.ceilings or not metrics:
        return []
    frames = protocol.frames.numbers
    return [_job(run, view, frames, metrics, protocol.measurement) for view in views]


def read_ceilings(jobs: Sequence[Job]) -> dict[str, dict[str, Any]]:
    """Read the results of `ceiling_jobs`.

    Returns:
        view -> ``noise_free`` and ``second_recording``, metric -> value, and ``not_computed``, metric -> reason.
    """
    return {job.folder.name: read_json(job.folder / JOB_FILE) for job in jobs}


def find_seen_view(view: str, psnrs_db: Collection[float], perfect: Mapping[str, Any] | None) -> list[Finding]:
    """Report a view whose renders are better than a perfect one's, see `find_seen`.

    Args:
        view: name.
        psnrs_db: of its frames; empty if they were not measured.
        perfect: its record of `read_ceilings`; None if there is none.
    """
    ceiling_db = (perfect or {}).get("noise_free", {}).get(COMPARED)
    return [] if ceiling_db is None or not psnrs_db else find_seen(view, float(np.mean(list(psnrs_db))), ceiling_db)


def find_seen_views(run: RunFolder, label: str) -> list[Finding]:
    """Ask the same of frames that need not have been scored, and of a protocol that wants no ceilings.

    They are estimated only where renders are so good that they may be above: noise of `LEAST_DB` would be seen by everybody.
    """
    protocol, findings = run.protocol(), []
    wanted = replace(protocol, measurement=replace(protocol.measurement, metrics=(COMPARED,), ceilings=True))
    for name, view in views_of_run(run, label, as_measured=True).items():
        psnrs_db = [psnr(*pair) for pair in view.pairs(list(view.frames))]
        if np.mean(psnrs_db) > LEAST_DB:
            (job,) = ceiling_jobs(run, wanted, [name])
            findings += find_seen_view(name, psnrs_db, job.work(run.root))
    return findings


def write_references(run: RunFolder, paths: Mapping[str, dict[str, Any]], records: Mapping[str, dict[str, Any]]) -> None:
    """Write ``references.json``, which the report shows as grey rows.

    Args:
        records: see `read_ceilings`.
    """
    groups: dict[str, list[str]] = {}
    for name in ceiling_metrics():
        groups.setdefault(METRICS[name].group.key, []).append(name)
    entries = [
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
    if TRUTH in paths:
        values = {name: value for name, pose, value in paths[TRUTH]["values"] if pose < 0} | paths[TRUTH]["not_computed"]
        entries.append({"group": "path", "name": "Captured images", "note": PATH_NOTE, "values": values})
    write_json(run.root / "references.json", entries)


def _means(records: Mapping[str, dict[str, Any]], kind: str, metrics: Sequence[str]) -> dict[str, float | str]:
    """Return the mean over the views of each metric; the reason where one of them has none."""
    means: dict[str, float | str] = {}
    for metric in metrics:
        absent = {view: record["not_computed"] | record.get(f"no_{kind}", {}) for view, record in records.items()}
        reasons = [f"{view}: {of_view[metric]}" for view, of_view in absent.items() if metric in of_view]
        values = [record[kind][metric] for record in records.values() if metric in record[kind]]
        if reasons or values:
            means[metric] = reasons[0] if reasons else float(np.mean(values))
    return means


def _bounds(records: Mapping[str, dict[str, Any]], kind: str, metrics: Sequence[str]) -> dict[str, str]:
    """Sides on which means are bounds, because one of the views has no more than a bound."""
    sides = (record.get(f"{kind}_bounds", {}) for record in records.values())
    return {name: side for of_view in sides for name, side in of_view.items() if name in metrics}


def _job(run: RunFolder, view: str, frames: range, metrics: Sequence[str], measurement: Measurement) -> Job:
    coding = run.capture_record().get("coding", {}).get(view, {"unknown": UNRECORDED})
    identity = {
        "truth": digest_frames(run.truth(view), frames),
        "coding": coding,
        "metrics": list(metrics),
        "measurement": [str(value) for value in vars(measurement).values()],
        "code": ceilings_code(metrics),
    }
    work = partial(_estimate, run, view, frames, metrics, measurement, coding and Coding(**coding))
    return Job(f"ceilings of {view}", run.ceilings(view), identity, work)


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
        return {"noise_free": {}, "second_recording": {}, "not_computed": dict.fromkeys(metrics, str(error))}
    return {
        "noise_free": estimate.noise_free,
        "second_recording": estimate.second_recording,
        "not_computed": estimate.not_computed,
        "noise_free_bounds": estimate.bounds,
        "second_recording_bounds": estimate.second_bounds,
        "no_second_recording": dict.fromkeys(metrics, estimate.second_unknown) if estimate.second_unknown else {},
        "sigma_255": float(np.median(estimate.noise.sigma_255)),
        "averaged_share": estimate.averaged_share,
    }
