"""Score the camera path: view consistency of each method's images along it, without any truth."""

from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.camera import Camera
from ggvs_eval.coverage import lacks_path, path_poses
from ggvs_eval.files.digest import digest_files
from ggvs_eval.files.images import read_image
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathPose
from ggvs_eval.metrics.path_scores import measured_on_path, score_path
from ggvs_eval.metrics.registry import METRICS, select_metrics
from ggvs_eval.pipelines.run.path_depth import pose_file, read_path_depth
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import (
    JOB_FILE,
    RunFolder,
    frame_path,
    missing_frames,
    read_json,
    require_frames,
)
from ggvs_eval.scoring import Row, ScorePart, ScoreRequest
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.task import Task

PATH_VIEW = "path"  # the name in the table's column of views
TRUTH = "truth"
TRUTH_NOTE = "ground truth of a camera on the path, measured like the methods."
PATH_SCORES = "ggvs_eval.metrics.path_scores"


def plan_path_scores(request: ScoreRequest) -> ScorePart:
    """Plan what is measured along the camera path of a run."""
    is_asked = request.units is None or PATH_VIEW in request.units
    tasks = path_tasks(request.run, request.protocol, request.labels) if is_asked else []
    rows = partial(path_rows, tasks, request.protocol)
    return ScorePart(tasks=tuple(tasks), rows=rows, references=partial(true_rows, tasks))


def path_rows(
    tasks: Sequence[Task], protocol: Protocol, label: str
) -> tuple[list[Row], dict[str, str]]:
    """Return the measures of a method's camera path, each over the whole path, and why some are not
    there.
    """
    metrics = select_metrics(protocol.measurement.metrics)
    names = [metric.name for metric in metrics if metric.kind == "path"]
    scores = read_paths(tasks).get(label)
    if scores is None:
        return [], dict.fromkeys(names, "no images along a camera path")
    reasons = {name: why for name, why in scores["not_computed"].items() if name in names}
    values = [(name, value) for name, pose, value in scores["values"] if pose < 0 and name in names]
    return [(PATH_VIEW, -1, name, value) for name, value in values], reasons


def true_rows(tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """Return the report's row of the captured images along the path, where the capture has some."""
    scores = read_paths(tasks).get(TRUTH)
    if scores is None:
        return []
    values = {name: value for name, pose, value in scores["values"] if pose < 0}
    values |= scores["not_computed"]
    return [{"group": "path", "name": "Captured images", "note": TRUTH_NOTE, "values": values}]


def path_tasks(run: RunFolder, protocol: Protocol, labels: Sequence[str]) -> list[Task]:
    """Return what measures the path of every method that has one, and of the truth where the
    capture has true images of it.

    Returns:
        One per method; empty if there is no path, or the protocol asks for none of its measures.

    Raises:
        RenderError: pictures along the path that a method had are lost.
    """
    if not run.path_record.is_file() or not any(
        METRICS[name].kind == "path" for name in protocol.measurement.metrics
    ):
        return []
    poses = path_poses(run)
    require_frames(
        {f"{label} along the path": run.path(label) for label in labels if lacks_path(run, label)},
        poses,
    )
    rendered = [label for label in (TRUTH, *labels) if not missing_frames(run.path(label), poses)]
    metrics = {name: METRICS[name] for name in protocol.measurement.metrics}
    costly = sorted(
        name
        for name, metric in metrics.items()
        if isinstance(metric, PathMetric) and metric.scorer.wants_images
    )
    return [_task(run, label, len(poses), costly) for label in rendered]


def read_paths(tasks: Sequence[Task]) -> dict[str, dict[str, Any]]:
    """Read the results of `path_tasks`.

    Returns:
        label (or ``truth``) -> ``values``, a list of (measure, pose or -1, value), and
        ``not_computed``, measure -> reason.
    """
    return {task.folder.name: read_json(task.folder / JOB_FILE) for task in tasks}


def _task(run: RunFolder, label: str, n_poses: int, costly: Sequence[str]) -> Task:
    frames = [frame_path(run.path(label), pose) for pose in range(n_poses)]
    depths = [pose_file(run.path_depth, pose) for pose in range(n_poses)]
    inputs = {
        "rendered": digest_files(frames),
        "depth": digest_files([file for file in depths if file.is_file()]),
        "path": digest_files([run.path_record]),
        "code": path_code(costly),
    }
    make = partial(_score, run, label, costly)
    return Task(
        name=f"path of {label}",
        folder=run.path_scores(label),
        inputs=inputs,
        make=make,
        kind="path score",
    )


def path_code(names: Collection[str]) -> str:
    """Hash of the code that measures a camera path: one pass over it measures all that it has, and
    what is named of the rest.
    """
    modules = [module for metric in measured_on_path(names) for module in metric.modules]
    return code_of(PATH_SCORES, PathMetric.__module__, *modules)


def _score(run: RunFolder, label: str, costly: Sequence[str], _folder: Path) -> dict[str, Any]:
    scores = score_path(_poses(run, label), metrics=costly)
    values = [(name, -1 if pose is None else pose, value) for name, pose, value in scores.values]
    return {
        "values": values,
        "not_computed": scores.not_computed,
        "rows": list(scores.rows),
        "n_switches": scores.n_switches,
    }


def _poses(run: RunFolder, label: str) -> Iterator[PathPose]:
    record = read_json(run.path_record)
    for index, (values, sources) in enumerate(
        zip(record["cameras"], record["sources"], strict=True)
    ):
        camera = Camera.from_json(f"path{index:04d}", values)
        depth = (
            read_path_depth(run.path_depth, index)
            if pose_file(run.path_depth, index).is_file()
            else None
        )
        yield PathPose(
            camera=camera,
            image=read_image(frame_path(run.path(label), index)),
            depth=depth,
            sources=sources,
        )
