"""Score one view: every method's frames against the captured ones, as one job, because the truth's part is then done once."""

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image, resize
from ggvs_eval.jobs.job import Job, code_digest
from ggvs_eval.metrics.image.fetch_lpips import weights_path
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.registry import scored_by_view
from ggvs_eval.pipelines.run.coverage import Coverage
from ggvs_eval.protocol import Measurement, Protocol
from ggvs_eval.run_folder import JOB_FILE, RunFolder, frame_path, missing_frames, read_json


def view_job(run: RunFolder, protocol: Protocol, coverage: Coverage, labels: Sequence[str], view: str) -> Job:
    """The job of one view; a method in it is stale when a frame, the measurement or the metrics' code changes."""
    measurement = protocol.measurement
    common = {
        "truth": digest_frames(run.truth(view), coverage.wanted),
        "disoccluded": digest_frames(run.disoccluded(view), coverage.wanted),
        "measurement": [str(value) for value in vars(measurement).values()],
        "lpips_weights": weights_path(measurement.lpips_net).is_file(),
        "code": code_digest("ggvs_eval.metrics"),
    }
    stretches = {label: there for label in labels if (there := coverage.stretches(label, view))}
    identities = {
        label: common
        | {"rendered": digest_frames(run.renders(label, view), coverage.frames(label, view))}
        | coverage.identity(label, view)
        for label in stretches
    }
    work = partial(_score_view, run, view, tuple(labels), identities, stretches, measurement)
    return Job(f"scores of {view}", run.scores(view), identities, work)


def digest_frames(folder: Path, frames: Sequence[int]) -> str:
    """SHA-256 of the wanted frames of a folder; empty where they are not all there."""
    digest = hashlib.sha256()
    for index in frames:
        file = frame_path(folder, index)
        if not file.is_file():
            return ""
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _score_view(
    run: RunFolder,
    view: str,
    asked: Sequence[str],
    identities: dict[str, Any],
    stretches: dict[str, tuple[range, ...]],
    measurement: Measurement,
    _folder: Path,
) -> dict[str, Any]:
    """Measure the methods of one view whose frames changed, those with the same frames side by side; others' values stay."""
    known = run.scores(view) / JOB_FILE
    records = read_json(known)["methods"] if known.is_file() else {}
    methods = {
        label: record for label, record in records.items() if label not in asked or record["identity"] == identities.get(label)
    }
    alike: dict[tuple[range, ...], list[str]] = defaultdict(list)
    for label in identities:
        if label not in methods:
            alike[stretches[label]].append(label)
    for there, labels in alike.items():
        for label, record in zip(labels, _score_methods(run, view, labels, there, measurement), strict=True):
            methods[label] = {"identity": identities[label]} | record
    return {"methods": methods}


def _score_methods(
    run: RunFolder, view: str, labels: Sequence[str], stretches: tuple[range, ...], measurement: Measurement
) -> list[dict[str, Any]]:
    """Values of methods that have the same frames; frames are streamed, two instants in memory.

    What is measured from frame to frame is measured inside each stretch of consecutive frames; what belongs to the whole
    sequence only where there is one stretch.
    """
    from ggvs_eval.metrics.stream import fit_colour_maps, score_views

    folders = [run.renders(label, view) for label in labels]
    metrics, options = scored_by_view(measurement.metrics), metric_options(measurement)
    records: list[dict[str, Any]] = [{"values": [], "not_computed": {}} for _ in labels]
    names, maps = [metric.name for metric in metrics], None
    if options.colour_scope == "view" and any(metric.corrects_colours for metric in metrics):
        maps = fit_colour_maps(one for frames in stretches for one in _instants(folders, run.truth(view), frames, measurement))
    for frames in stretches:
        instants = _instants(folders, run.truth(view), frames, measurement)
        masks = _disoccluded(run.disoccluded(view), frames, measurement)
        scored = score_views(instants, names, options, colour_maps=maps, disoccluded=masks)
        for record, scores in zip(records, scored, strict=True):
            values = [(name, -1 if index is None else frames[index], value) for name, index, value in scores.values]
            record["values"] += [value for value in values if value[1] >= 0 or len(stretches) == 1]
            record["not_computed"] |= scores.not_computed
    return records


def metric_options(measurement: Measurement) -> MetricOptions:
    """What the protocol chooses about the metrics."""
    return MetricOptions(
        ssim=measurement.ssim,
        lpips_net=measurement.lpips_net,
        sted_pairing=measurement.sted_pairing,
        sted_pooling=measurement.sted_pooling,
        colour_scope=measurement.colour_scope,
        ddof=measurement.ddof,
    )


def truth_frames(run: RunFolder, view: str, frames: range, measurement: Measurement) -> Iterator[Image8]:
    """The captured frames of a view at the size at which they are measured."""
    for _, truth in _instants((), run.truth(view), frames, measurement):
        yield truth


def _disoccluded(folder: Path, frames: range, measurement: Measurement) -> Iterator[Mask] | None:
    """Where no source camera sees the view; None where nobody has worked it out."""
    if missing_frames(folder, frames):
        return None
    return (_read_mask(frame_path(folder, index), measurement) for index in frames)


def _read_mask(path: Path, measurement: Measurement) -> Mask:
    mask = read_image(path)[..., 0]
    if measurement.width:
        mask = cv2.resize(mask, (measurement.width, measurement.height), interpolation=cv2.INTER_NEAREST)
    return mask > 127


def _instants(
    folders: Sequence[Path], truth: Path, frames: range, measurement: Measurement
) -> Iterator[tuple[list[Image8], Image8]]:
    """Every method's frame and the true one of each instant, at the size at which they are measured."""
    for index in frames:
        paths = [frame_path(folder, index) for folder in (*folders, truth)]
        images = [read_image(path) for path in paths]
        for path, image in zip(paths, images, strict=True):
            if image.shape != images[-1].shape:
                wanted, came = images[-1].shape[1::-1], image.shape[1::-1]
                raise RenderError(
                    f"{path}: wanted {wanted[0]} x {wanted[1]} pixels as the truth has, got {came[0]} x {came[1]}; "
                    "render at the protocol's size"
                )
        if measurement.width:
            images = [resize(image, measurement.width, measurement.height, measurement.resize_filter) for image in images]
        yield images[:-1], images[-1]
