"""Score all methods of a view in one job, so that the reference is processed once."""

import hashlib
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.coverage import Coverage, frame_reader
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.jobs.job import Job
from ggvs_eval.kernels import _core
from ggvs_eval.measured_frames import measured_frame, measured_mask, measuring_way
from ggvs_eval.merged_results import join_versions
from ggvs_eval.metric_choices import MetricChoices
from ggvs_eval.metrics.metric import MetricOptions, ViewMetric
from ggvs_eval.metrics.registry import METRICS, scored_by_view, select_metrics
from ggvs_eval.pipelines.run.score_code import checks_code, metric_code
from ggvs_eval.protocol import Measurement, Protocol
from ggvs_eval.results import installed_versions
from ggvs_eval.run_folder import JOB_FILE, ON_SCREEN, RunFolder, frame_path, missing_frames, read_json
from ggvs_eval.scoring import QUESTIONS

UNSEEN = "none of its frames is one that this metric looks at (lpips_every)"


def view_job(
    run: RunFolder,
    protocol: Protocol,
    coverage: Coverage,
    labels: Sequence[str],
    view: str,
    device: str = "cpu",
) -> Job:
    """Return the job of one view.

    In it all values of a method are stale when a frame changes, and one metric when its code does.
    """
    options = metric_options(protocol.measurement, device)
    measurement = protocol.measurement
    metrics = scored_by_view(measurement.metrics)
    common: dict[str, Any] = {
        "truth": digest_frames(run.truth(view), coverage.numbers),
        "disoccluded": digest_frames(run.disoccluded(view), coverage.numbers),
        "measurement": [str(value) for name, value in vars(measurement).items() if name not in ("metrics", "as_")],
        "metrics": {metric.name: _metric_identity(metric, options) for metric in metrics},
        "checks": checks_code(),
    } | ({} if measurement.as_ == "as-is" else {"as": measurement.as_})
    stretches = {label: there for label in labels if (there := coverage.stretches(label, view))}
    identities = {
        label: common
        | {"rendered": digest_frames(run.renders(label, view), coverage.frames(label, view))}
        | coverage.identity(label, view)
        for label in stretches
    }
    work = partial(_score_view, run, view, tuple(labels), identities, stretches, protocol, options)
    return Job(f"scores of {view}", run.scores(view), identities, work, renews=True)


def _metric_identity(metric: ViewMetric, options: MetricOptions) -> dict[str, Any]:
    """Return what one metric depends on next to the frames and the measurement; the CPU is not named."""
    weights = {} if metric.weights is None else {"weights": metric.weights(options).is_file()}
    elsewhere = {"device": options.device} if metric.on_device and options.device != "cpu" else {}
    return {"code": metric_code(metric)} | weights | elsewhere


def digest_frames(folder: Path, frames: Sequence[int]) -> str:
    """SHA-256 of the wanted frames of a folder; empty if they are not all there."""
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
    protocol: Protocol,
    options: MetricOptions,
    _folder: Path,
) -> dict[str, Any]:
    """Measure stale metrics, methods with the same frames and stale metrics side by side; all other values stay.

    Reading:
        Of what is on a screen no question is asked: that pictures are late and repeated is what its row measures.
    """
    _core.forget_idle()  # of what was rendered in this process: at 1352 x 1014 two thirds of a gigabyte
    record_file = run.scores(view) / JOB_FILE
    before = read_json(record_file) if record_file.is_file() else {"methods": {}}
    records = before["methods"]
    methods = {label: record for label, record in records.items() if label not in asked}
    unchecked: list[str] = []
    alike: dict[tuple[tuple[range, ...], tuple[str, ...]], list[str]] = defaultdict(list)
    for label, identity in identities.items():
        record = records.get(label, {})
        fresh = fresh_metrics(record.get("identity", {}), identity)
        methods[label] = {"identity": identity} | _values_of(fresh, record, options)
        methods[label]["versions"] = join_versions([record.get("versions", {})] if fresh else [])
        is_checked = "faults" in record and {**record["identity"], "metrics": {}} == {**identity, "metrics": {}}
        methods[label]["faults"] = record["faults"] if is_checked else []
        unchecked += [] if is_checked or label.endswith(ON_SCREEN) else [label]
        if stale := tuple(name for name in identity["metrics"] if name not in fresh):
            alike[stretches[label], stale].append(label)
    for (there, metrics), labels in alike.items():
        folders = [run.renders(label, view) for label in labels]
        with _computing(options.device):
            scores = _score_methods(run, view, folders, there, metrics, protocol, options)
        for label, measured in zip(labels, scores, strict=True):
            methods[label] |= _replaced(methods[label], measured)
    truth, numbers = frame_reader(run.truth(view)), protocol.frames.numbers
    checks = [question.of_view(view, truth, numbers) for question in QUESTIONS.built_in().values()]
    for label in unchecked:  # behind the metrics, which refuse frames of another size
        rendered, longest = frame_reader(run.renders(label, view)), max(stretches[label], key=len)
        findings = [finding for check in checks for finding in check(rendered, longest)]
        methods[label]["faults"] = [asdict(finding) for finding in findings]
    parts = [(*one.pooling(options).parts, one.name) for one in select_metrics(protocol.measurement.metrics)]
    order = {name: place for place, name in enumerate(dict.fromkeys(name for names in parts for name in names))}
    for record in methods.values():  # whatever was measured together; what belongs to no frame comes last
        record["values"].sort(key=lambda value: (value[1] < 0, value[1], order.get(value[0], len(order)), value[0]))
    stands = all(methods.get(label, {}).get("identity") == record["identity"] for label, record in records.items())
    also = [before["sha256"], *before.get("also", ())] if records and stands else []
    return {"methods": methods, "also": also}


def _replaced(kept: Mapping[str, Any], measured: Mapping[str, Any]) -> dict[str, Any]:
    """Merge cached and new values; companion metrics are kept only if new."""
    new = {value[0] for value in measured["values"]} | set(measured["not_computed"])
    reasons = {name: reason for name, reason in kept["not_computed"].items() if name not in new}
    return {
        "values": [value for value in kept["values"] if value[0] not in new] + measured["values"],
        "not_computed": reasons | measured["not_computed"],
        "versions": join_versions([kept["versions"], installed_versions()]),
    }


def _computing(device: str) -> AbstractContextManager[None]:
    """Explain a failure on a device; torch is not imported for the CPU."""
    if device == "cpu":
        return nullcontext()
    from ggvs_eval.compute_device import out_of_memory

    return out_of_memory(device, "score on the cpu (--device cpu)")


def fresh_metrics(recorded: Mapping[str, Any], current: Mapping[str, Any]) -> set[str]:
    """Metrics whose cached values are valid: none if anything differs except the identity of a metric or of the checks."""
    if {**recorded, "metrics": {}, "checks": ""} != {**current, "metrics": {}, "checks": ""}:
        return set()
    return {name for name, identity in current["metrics"].items() if recorded["metrics"].get(name) == identity}


def _values_of(metrics: Collection[str], record: Mapping[str, Any], options: MetricOptions) -> dict[str, Any]:
    """Return the part of a record that belongs to some metrics: their own values, and the parts that they are pooled from."""
    names = {name for metric in metrics for name in (metric, *METRICS[metric].pooling(options).parts)}
    values = [value for value in record.get("values", ()) if value[0] in names]
    reasons = record.get("not_computed", {})
    return {"values": values, "not_computed": {name: reason for name, reason in reasons.items() if name in metrics}}


def _score_methods(
    run: RunFolder,
    view: str,
    folders: Sequence[Path],
    stretches: tuple[range, ...],
    metrics: Sequence[str],
    protocol: Protocol,
    options: MetricOptions,
) -> list[dict[str, Any]]:
    """Some metrics of methods that have the same frames; frames are streamed, two instants in memory.

    What is measured from frame to frame is measured inside each stretch of consecutive frames; what belongs to the whole
    sequence only if there is one stretch.
    """
    from ggvs_eval.metrics.stream import fit_colour_maps, score_views

    measurement, truth = protocol.measurement, run.truth(view)
    records: list[dict[str, Any]] = [{"values": [], "not_computed": {}} for _ in folders]
    maps, corrected = None, any(metric.corrects_colours for metric in scored_by_view(metrics))
    if options.colour_scope == "view" and corrected:
        maps = fit_colour_maps(one for frames in stretches for one in _instants(folders, truth, frames, measurement))
    for frames in stretches:
        instants = _instants(folders, truth, frames, measurement)
        masks = _disoccluded(run.disoccluded(view), frames, measurement)
        placed = replace(options, first_frame=frames.start - protocol.frames.start)
        scored = score_views(instants, metrics, placed, colour_maps=maps, disoccluded=masks)
        for record, scores in zip(records, scored, strict=True):
            values = [(name, -1 if index is None else frames[index], value) for name, index, value in scores.values]
            record["values"] += [value for value in values if value[1] >= 0 or len(stretches) == 1]
            record["not_computed"] |= scores.not_computed
    for record in records:  # what one stretch lacks another may have
        measured = {value[0] for value in record["values"]}
        reasons = dict.fromkeys(metrics if len(stretches) == 1 else (), UNSEEN) | record["not_computed"]
        record["not_computed"] = {name: why for name, why in reasons.items() if name not in measured}
    return records


def metric_options(measurement: Measurement, device: str = "cpu") -> MetricOptions:
    """Return the protocol's options of the metrics, and where those compute that can."""
    chosen = {field.name: getattr(measurement, field.name) for field in fields(MetricChoices)}
    if way := measuring_way(measurement):
        chosen["ssim"] = way.ssim
    return MetricOptions(**chosen, device=device)


def truth_frames(run: RunFolder, view: str, frames: range, measurement: Measurement) -> Iterator[Image8]:
    """Yield the captured frames of a view at the size at which they are measured."""
    for _, truth in _instants((), run.truth(view), frames, measurement):
        yield truth


def _disoccluded(folder: Path, frames: range, measurement: Measurement) -> Iterator[Mask] | None:
    """Read the masks of what no source camera sees of the view; None if they have not been computed."""
    if missing_frames(folder, frames):
        return None
    return (measured_mask(read_image(frame_path(folder, index))[..., 0], measurement) for index in frames)


def _instants(
    folders: Sequence[Path], truth: Path, frames: range, measurement: Measurement
) -> Iterator[tuple[list[Image8], Image8]]:
    """Yield every method's frame and the true one of each instant, at the size at which they are measured."""
    for index in frames:
        paths = [frame_path(folder, index) for folder in (*folders, truth)]
        images = [read_image(path) for path in paths]
        for path, image in zip(paths, images, strict=True):
            if image.shape != images[-1].shape:
                true_size, size = images[-1].shape[1::-1], image.shape[1::-1]
                raise RenderError(
                    f"{path}: wanted {true_size[0]} x {true_size[1]} pixels as the truth has, got {size[0]} x {size[1]}; "
                    "render at the protocol's size"
                )
        measured = [measured_frame(image, measurement) for image in images]
        yield measured[:-1], measured[-1]
