"""Scores of the methods in one view: a task per metric, measured together, so that frames are
decoded once.
"""

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.coverage import Coverage, frame_reader
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.kernels import _core
from ggvs_eval.measured_frames import measured_frame, measured_mask, measuring_way
from ggvs_eval.metric_choices import MetricChoices
from ggvs_eval.metrics.metric import MetricOptions, ViewMetric
from ggvs_eval.metrics.registry import METRICS, scored_by_view
from ggvs_eval.pipelines.methods.stage_costs import score_cost
from ggvs_eval.pipelines.run.score_code import checks_code, metric_code
from ggvs_eval.protocol import Measurement, Protocol
from ggvs_eval.renders.request import read_header
from ggvs_eval.run_folder import ON_SCREEN, RunFolder, frame_path, missing_frames
from ggvs_eval.scoring import QUESTIONS, WHOLE, MetricScores, Value
from ggvs_eval.tasks.task import Task

UNSEEN = "none of its frames is one that this metric looks at (lpips_every)"
CHECKS = "checks"  # folder of what the quick checks find, next to those of the metrics
ABOVE = 2  # scores/<view>/<label>/<metric>: those of a view are measured together


@dataclass(frozen=True, kw_only=True)
class ScoreTask(Task):
    """One metric of one method in one view, or what the quick checks find in its frames.

    Attributes:
        metric: its name, or `CHECKS`.
    """

    label: str
    view: str
    metric: str


def score_tasks(
    run: RunFolder,
    protocol: Protocol,
    coverage: Coverage,
    labels: Sequence[str],
    view: str,
    device: str = "cpu",
) -> list[ScoreTask]:
    """Return what measures some methods in one view.

    Values are stale when a frame changes, or the code of their metric.

    Reading:
        Metrics with one scorer are measured in one pass and kept one by one, so that adding one
        measures it alone. Of what is on a screen no question is asked: that pictures are late and
        repeated is what its row measures.
    """
    measurement = protocol.measurement
    options = metric_options(measurement, device)
    common: dict[str, Any] = {
        "truth": digest_frames(run.truth(view), coverage.numbers),
        "disoccluded": digest_frames(run.disoccluded(view), coverage.numbers),
        "measurement": [
            str(value)
            for name, value in vars(measurement).items()
            if name not in ("metrics", "as_")
        ],
        "as": measurement.as_,
    }
    metrics = {
        metric.name: _metric_inputs(metric, options)
        for metric in scored_by_view(measurement.metrics)
    }
    parts = metrics | {CHECKS: {"code": checks_code()}}
    stretches = {label: ranges for label in labels if (ranges := coverage.stretches(label, view))}
    together = partial(_score_view, run, view, stretches, protocol, options)
    width, height = read_header(frame_path(run.truth(view), protocol.frames.start)).size
    cost_s = score_cost(measurement) * width * height / 1e6 / len(parts)
    tasks = []
    for label in stretches:
        rendered = digest_frames(run.renders(label, view), coverage.frames(label, view))
        frames = common | {"rendered": rendered} | coverage.identity(label, view)
        for metric, inputs in (metrics if label.endswith(ON_SCREEN) else parts).items():
            task = ScoreTask(
                name=f"scores of {view}",
                folder=run.scores(view) / label / metric,
                inputs=frames | inputs,
                together=together,
                kind="score",
                count=len(coverage.frames(label, view)),
                cost_s=cost_s,
                above=ABOVE,
                label=label,
                view=view,
                metric=metric,
            )
            tasks.append(task)
    return tasks


def _metric_inputs(metric: ViewMetric, options: MetricOptions) -> dict[str, Any]:
    """Return what one metric depends on next to the frames and the measurement.

    The CPU is not named.
    """
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
    stretches: Mapping[str, tuple[range, ...]],
    protocol: Protocol,
    options: MetricOptions,
    tasks: Sequence[ScoreTask],
) -> Iterator[tuple[ScoreTask, Mapping[str, Any]]]:
    """Measure what is asked for; methods with the same frames and metrics side by side."""
    # of what was rendered in this process: at 1352 x 1014 two thirds of a gigabyte
    _core.forget_idle()
    by_label: dict[str, dict[str, ScoreTask]] = defaultdict(dict)
    for task in tasks:
        by_label[task.label][task.metric] = task
    alike: dict[tuple[tuple[range, ...], tuple[str, ...]], list[str]] = defaultdict(list)
    for label, of_label in by_label.items():
        if metrics := tuple(metric for metric in of_label if metric != CHECKS):
            alike[stretches[label], metrics].append(label)
    for (ranges, metrics), labels in alike.items():
        folders = [run.renders(label, view) for label in labels]
        with _computing(options.device):
            scores = _score_methods(run, view, folders, ranges, metrics, protocol, options)
        for label, of_method in zip(labels, scores, strict=True):
            for metric in metrics:
                parts = [
                    part for part in METRICS[metric].pooling(options).parts if part not in METRICS
                ]
                yield by_label[label][metric], vars(of_method.of(metric, parts))
    unchecked = [label for label, of_label in by_label.items() if CHECKS in of_label]
    truth, numbers = frame_reader(run.truth(view)), protocol.frames.numbers
    checks = [
        question.of_view(view, truth, numbers)
        for question in QUESTIONS.built_in().values()
        if unchecked
    ]
    for label in unchecked:  # behind the metrics, which refuse frames of another size
        rendered, longest = frame_reader(run.renders(label, view)), max(stretches[label], key=len)
        findings = [finding for check in checks for finding in check(rendered, longest)]
        yield by_label[label][CHECKS], {"findings": [asdict(finding) for finding in findings]}


def _computing(device: str) -> AbstractContextManager[None]:
    """Explain a failure on a device; torch is not imported for the CPU."""
    if device == "cpu":
        return nullcontext()
    from ggvs_eval.compute_device import out_of_memory

    return out_of_memory(device, "score on the cpu (--device cpu)")


def _score_methods(
    run: RunFolder,
    view: str,
    folders: Sequence[Path],
    stretches: tuple[range, ...],
    metrics: Sequence[str],
    protocol: Protocol,
    options: MetricOptions,
) -> list[MetricScores]:
    """Some metrics of methods that have the same frames.

    Frames are streamed, two instants in memory.

    What is measured from frame to frame is measured inside each stretch of consecutive frames; what
    belongs to the whole sequence only if there is one stretch.
    """
    from ggvs_eval.metrics.stream import fit_colour_maps, score_views

    measurement, truth = protocol.measurement, run.truth(view)
    values: list[list[Value]] = [[] for _ in folders]
    reasons: list[dict[str, str]] = [{} for _ in folders]
    maps, corrected = None, any(metric.corrects_colours for metric in scored_by_view(metrics))
    if options.colour_scope == "view" and corrected:
        maps = fit_colour_maps(
            pair for frames in stretches for pair in _instants(folders, truth, frames, measurement)
        )
    for frames in stretches:
        instants = _instants(folders, truth, frames, measurement)
        masks = _disoccluded(run.disoccluded(view), frames, measurement)
        placed = replace(options, first_frame=frames.start - protocol.frames.start)
        scored = score_views(instants, metrics, placed, colour_maps=maps, disoccluded=masks)
        for number, scores in enumerate(scored):
            placed_values = [
                (name, WHOLE if index is None else frames[index], value)
                for name, index, value in scores.values
            ]
            values[number] += [
                value for value in placed_values if value[1] != WHOLE or len(stretches) == 1
            ]
            reasons[number] |= scores.not_computed
    unseen = dict.fromkeys(metrics if len(stretches) == 1 else (), UNSEEN)
    scores_of_methods = []
    # what one stretch lacks another may have
    for of_method, absent in zip(values, reasons, strict=True):
        names = {name for name, _, _ in of_method}
        lacking = {name: why for name, why in (unseen | absent).items() if name not in names}
        scores_of_methods.append(MetricScores(values=of_method, not_computed=lacking))
    return scores_of_methods


def metric_options(measurement: Measurement, device: str = "cpu") -> MetricOptions:
    """Return the protocol's options of the metrics, and where those compute that can."""
    choices = {field.name: getattr(measurement, field.name) for field in fields(MetricChoices)}
    if way := measuring_way(measurement):
        choices["ssim"] = way.ssim
    return MetricOptions(**choices, device=device)


def truth_frames(
    run: RunFolder, view: str, frames: range, measurement: Measurement
) -> Iterator[Image8]:
    """Yield the captured frames of a view at the size at which they are measured."""
    for _, truth in _instants((), run.truth(view), frames, measurement):
        yield truth


def _disoccluded(folder: Path, frames: range, measurement: Measurement) -> Iterator[Mask] | None:
    """Read the masks of what no source camera sees of the view.

    None if they have not been computed.
    """
    if missing_frames(folder, frames):
        return None
    return (
        measured_mask(read_image(frame_path(folder, index))[..., 0], measurement)
        for index in frames
    )


def _instants(
    folders: Sequence[Path], truth: Path, frames: range, measurement: Measurement
) -> Iterator[tuple[list[Image8], Image8]]:
    """Yield every method's frame and the true one of each instant, at the size at which they are
    measured.
    """
    for index in frames:
        paths = [frame_path(folder, index) for folder in (*folders, truth)]
        images = [read_image(path) for path in paths]
        for path, image in zip(paths, images, strict=True):
            if image.shape != images[-1].shape:
                true_size, size = images[-1].shape[1::-1], image.shape[1::-1]
                raise RenderError(
                    f"{path}: wanted {true_size[0]} x {true_size[1]} pixels as the truth has, got "
                    f"{size[0]} x {size[1]}; render at the protocol's size"
                )
        pictures = [measured_frame(image, measurement) for image in images]
        yield pictures[:-1], pictures[-1]
