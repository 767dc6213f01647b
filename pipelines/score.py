"""Score: the 8-bit frames on disk against the captured ones, whoever rendered them.

Each view is one job for all methods, because what the truth alone decides is then computed once; the values lie in
``RUN/scores/<view>/job.json``, and a method that is there already, with the same frames, is not measured again.
"""

import dataclasses
import hashlib
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.errors import RenderError
from ggvs_eval.images import Image8, read_image, resize
from ggvs_eval.metrics.fetch_lpips import weights_path
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines.jobs import Job, code_digest, run_jobs
from ggvs_eval.pipelines.methods import METHODS, split_label
from ggvs_eval.protocol import Measurement, Protocol
from ggvs_eval.results import Results, installed_versions, make_table
from ggvs_eval.run_folder import JOB_FILE, RunFolder, frame_path, read_json, require_frames, write_json


def score(run: RunFolder, workers: int = 1) -> Results:
    """Measure every method that has renders in the run folder.

    Args:
        run: a folder with truth and renders of the protocol's views and frames.
        workers: processes.

    Returns:
        All values, also written to the run folder.

    Raises:
        RenderError: no renders, missing frames (all gaps are listed) or frames of the wrong size.
    """
    protocol, labels = run.protocol(), run.labels()
    if not labels:
        raise RenderError(
            f"{run.root}: nothing to score, renders/ is empty; run `ggvs-eval render` or give --renders NAME=FOLDER"
        )
    frames = range(protocol.frames.start, protocol.frames.start + protocol.frames.count)
    folders = {f"{label} in {view}": run.renders(label, view) for label in labels for view in protocol.views.test}
    require_frames(folders, frames)
    run_jobs([_score_job(run, protocol, labels, view) for view in protocol.views.test], workers, "scoring")
    results = _collect(run, protocol, labels)
    results.write(run.root)
    _write_shown_names(run, protocol, labels)
    return results


def import_renders(run: RunFolder, label: str, folder: Path) -> None:
    """Make frames that others rendered, ``folder/<view>/<frame>.png``, a method of this run.

    The frames are linked, not copied; every view and frame of the protocol must be there.

    Raises:
        RenderError: a gap, or a label that is taken.
    """
    protocol = run.protocol()
    if label in METHODS or not label or label.startswith(".") or "/" in label:
        raise RenderError(f"renders cannot be called {label!r}; choose a plain name that is not one of {', '.join(METHODS)}")
    frames = range(protocol.frames.start, protocol.frames.start + protocol.frames.count)
    require_frames({f"{label} in {view}": folder / view for view in protocol.views.test}, frames)
    link = run.root / "renders" / label
    link.parent.mkdir(parents=True, exist_ok=True)
    if link.is_symlink():
        link.unlink()
    elif link.exists():
        raise RenderError(f"{link} exists already; choose another name for these renders")
    link.symlink_to(folder.resolve(), target_is_directory=True)


def _score_job(run: RunFolder, protocol: Protocol, labels: Sequence[str], view: str) -> Job:
    """The job of one view; a method in it is stale when a frame, the measurement or the metrics' code changes."""
    frames = range(protocol.frames.start, protocol.frames.start + protocol.frames.count)
    measurement = protocol.measurement
    common = {
        "truth": _digest(run.truth(view), frames),
        "measurement": [str(value) for value in vars(measurement).values()],
        "lpips_weights": weights_path(measurement.lpips_net).is_file(),
        "code": code_digest("ggvs_eval.metrics"),
    }
    identities = {label: common | {"rendered": _digest(run.renders(label, view), frames)} for label in labels}
    work = partial(_score_view, run, view, identities, frames, measurement)
    return Job(f"scores of {view}", run.scores(view), identities, work)


def _digest(folder: Path, frames: range) -> str:
    digest = hashlib.sha256()
    for index in frames:
        digest.update(frame_path(folder, index).read_bytes())
    return digest.hexdigest()


def _score_view(
    run: RunFolder, view: str, identities: dict[str, Any], frames: range, measurement: Measurement, _folder: Path
) -> dict[str, Any]:
    """Measure the methods of one view whose frames changed; frames are streamed, two instants in memory."""
    from ggvs_eval.metrics.stream import MetricOptions, score_views

    known = run.scores(view) / JOB_FILE
    records = read_json(known)["methods"] if known.is_file() else {}
    methods = {label: records[label] for label in identities if records.get(label, {}).get("identity") == identities[label]}
    stale = [label for label in identities if label not in methods]
    folders = [run.renders(label, view) for label in stale]
    options = MetricOptions(lpips_net=measurement.lpips_net, sted_pairing=measurement.sted_pairing)
    scored = score_views(_instants(folders, run.truth(view), frames, measurement), _per_view_metrics(measurement), options)
    for label, scores in zip(stale, scored, strict=True):
        values = [(name, -1 if index is None else frames[index], value) for name, index, value in scores.values]
        methods[label] = {"identity": identities[label], "values": values, "not_computed": scores.not_computed}
    return {"methods": methods}


def _per_view_metrics(measurement: Measurement) -> list[str]:
    """What a view alone can tell; SDT and SDV are standard deviations of L1 over the whole table, see `_deviations`."""
    names = [name for name in measurement.metrics if name not in ("SDT", "SDV")]
    return names if "L1" in names or len(names) == len(measurement.metrics) else [*names, "L1"]


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


def _collect(run: RunFolder, protocol: Protocol, labels: Sequence[str]) -> Results:
    """One tidy table of all jobs, with the deviations over time (SDT) and views (SDV) that need more than one of them."""
    capture = run.capture_record()
    records = {view: read_json(run.scores(view) / JOB_FILE)["methods"] for view in protocol.views.test}
    rows: list[tuple[Any, ...]] = []
    not_computed: dict[str, str] = {}
    for label in labels:
        head = (protocol.dataset, capture["scene"], *split_label(label))
        l1: dict[str, list[float]] = {}
        for view, methods in records.items():
            values = methods[label]["values"]
            rows += [(*head, view, frame, name, value) for name, frame, value in values]
            l1[view] = [value for name, _, value in values if name == "L1"]
            not_computed |= methods[label]["not_computed"]
        rows += [(*head, *row) for row in _deviations(protocol, l1, not_computed)]
    renders = {f"{label}/{view}": records[view][label]["identity"]["rendered"] for label in labels for view in records}
    return Results(make_table(rows), _provenance(protocol, capture, renders), not_computed)


def _deviations(protocol: Protocol, l1: dict[str, list[float]], not_computed: dict[str, str]) -> list[tuple[Any, ...]]:
    """Rows (view, frame, metric, value) of SDT and SDV."""
    from ggvs_eval.metrics.temporal import sdt
    from ggvs_eval.metrics.views import sdv

    rows: list[tuple[Any, ...]] = []
    wanted, ddof = protocol.measurement.metrics, protocol.measurement.ddof
    if "SDT" in wanted and protocol.frames.count < 2:
        not_computed["SDT"] = f"{protocol.frames.count} frame; needs 2"
    elif "SDT" in wanted:
        rows += [(view, -1, "SDT", sdt([values], ddof)) for view, values in l1.items()]
    if "SDV" in wanted and len(l1) < 2:
        not_computed["SDV"] = f"{len(l1)} view; needs 2"
    elif "SDV" in wanted:
        by_frame = zip(*l1.values(), strict=True)
        rows += [(None, protocol.frames.start + t, "SDV", sdv([[v] for v in values], ddof)) for t, values in enumerate(by_frame)]
    return rows


def _provenance(protocol: Protocol, capture: dict[str, Any], renders: dict[str, str]) -> dict[str, Any]:
    return {
        "protocol": dataclasses.asdict(protocol),
        "protocol_sha256": protocol.sha256,
        "inputs": {f"{capture['scene']}/{name}": digest for name, digest in capture["digests"].items()},
        "renders": renders,
        "versions": installed_versions(),
    }


def _write_shown_names(run: RunFolder, protocol: Protocol, labels: Sequence[str]) -> None:
    """What the report calls methods and metrics; it reads this from disk and imports neither."""
    titles = {label: METHODS[label].title if label in METHODS else label for label in labels}
    ours = [label for label in labels if label in METHODS and METHODS[label].ours]
    write_json(run.root / "methods.json", {"labels": list(labels), "names": titles, "ours": ours})
    fields = ("unit", "higher_is_better", "describe", "reference")
    shown = {name: {field: getattr(METRICS[name], field) for field in fields} for name in protocol.measurement.metrics}
    write_json(run.root / "metrics.json", shown)
