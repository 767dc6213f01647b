"""Results for experiment trackers: TensorBoard, MLflow and Weights & Biases, each optional, all
without a network.
"""

import importlib.util
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.model.measured import MeasuredRun, distinct_names, read_scores
from ggvs_eval.results import split_label

Tracker = Literal["tensorboard", "mlflow", "wandb"]
# Tracker -> the package that writes its files, which is also the extra's content.
PACKAGES: Mapping[str, str] = {"tensorboard": "tensorboardX", "mlflow": "mlflow", "wandb": "wandb"}


MLFLOW_FILE = "mlflow.db"


@dataclass(frozen=True)
class TrackedMethod:
    """One method in one run, as a run of a tracker.

    Attributes:
        settings: what was asked for: the protocol's values under dotted names, its hash, scene and
            method.
        means: metric -> its number, as in the tables.
        curves: metric -> (frame, mean over the views) of those that have a value per frame.
    """

    name: str
    settings: Mapping[str, str]
    means: Mapping[str, float]
    curves: Mapping[str, Sequence[tuple[int, float]]]


def track_results(roots: Sequence[Path], tracker: Tracker, out: Path) -> Path:
    """Write the results of scored runs for a tracker.

    Args:
        roots: run folders; frames may be absent.
        out: folder for the tracker's files. MLflow writes a database there unless
            ``MLFLOW_TRACKING_URI`` names a place, W&B stays offline unless ``WANDB_MODE`` says
            otherwise.

    Raises:
        ResultsError: the tracker's package is not installed, or a folder that is no scored run.
    """
    if importlib.util.find_spec(PACKAGES[tracker]) is None:
        raise ResultsError(
            f"--to {tracker}: wanted the package {PACKAGES[tracker]}, got none; run pip install "
            f"'ggvs-eval[{tracker}]'"
        )
    runs = [read_scores(root) for root in roots]
    out.mkdir(parents=True, exist_ok=True)
    for run, name in zip(runs, distinct_names(roots), strict=True):
        for method in tracked_methods(run, name):
            WRITERS[tracker](method, run.protocol.name, out)
    return out


def tracked_methods(run: MeasuredRun, name: str) -> list[TrackedMethod]:
    """List the methods of a run of that name with what trackers get of each."""
    table = run.results.table
    labels = run.results.row_labels
    means: dict[Any, dict[Any, Any]] = run.results.summary().droplevel("dataset").to_dict("index")
    protocol = {
        "scene": run.scene,
        "protocol_sha256": run.protocol.sha256,
        **_flat(asdict(run.protocol)),
    }
    tracked = []
    for label in run.labels:
        rows = table[[row_label == label for row_label in labels]]
        framed = (
            rows[rows["frame"] >= 0]
            .groupby(["metric", "frame"], sort=False)["value"]
            .mean()
            .reset_index()
        )
        curves: dict[str, list[tuple[int, float]]] = {}
        for metric, frame, value in zip(
            framed["metric"], framed["frame"], framed["value"], strict=True
        ):
            curves.setdefault(str(metric), []).append((int(frame), float(value)))
        settings = {**protocol, "method": run.name(label)}
        numbers = {
            str(metric): float(value)
            for metric, value in means[split_label(label)].items()
            if not math.isnan(value)
        }
        tracked.append(
            TrackedMethod(name=f"{name}/{label}", settings=settings, means=numbers, curves=curves)
        )
    return tracked


def _flat(values: Mapping[str, Any], head: str = "") -> dict[str, str]:
    """Nested values under dotted names, as text."""
    flat: dict[str, str] = {}
    for key, value in values.items():
        flat |= (
            _flat(value, f"{head}{key}.")
            if isinstance(value, Mapping)
            else {f"{head}{key}": str(value)}
        )
    return flat


def _write_tensorboard(method: TrackedMethod, project: str, out: Path) -> None:
    from tensorboardX import SummaryWriter

    with SummaryWriter(str(out / project / method.name)) as writer:
        writer.add_text(
            "settings", "\n".join(f"- {name}: {value}" for name, value in method.settings.items())
        )
        for metric, value in method.means.items():
            writer.add_scalar(f"mean/{metric}", value)
        for metric, curve in method.curves.items():
            for frame, value in curve:
                writer.add_scalar(f"frame/{metric}", value, frame)


def _write_mlflow(method: TrackedMethod, project: str, out: Path) -> None:
    from mlflow import MlflowClient

    client = MlflowClient(
        tracking_uri=os.environ.get(
            "MLFLOW_TRACKING_URI", f"sqlite:///{(out / MLFLOW_FILE).resolve()}"
        )
    )
    experiment = client.get_experiment_by_name(project)
    place = experiment.experiment_id if experiment else client.create_experiment(project)
    run_id = client.create_run(place, run_name=method.name).info.run_id
    for name, value in method.settings.items():
        client.log_param(run_id, name, value)
    for metric, mean in method.means.items():
        client.log_metric(run_id, f"mean/{metric}", mean)
    for metric, curve in method.curves.items():
        for frame, mean in curve:
            client.log_metric(run_id, f"frame/{metric}", mean, step=frame)
    client.set_terminated(run_id)


def _write_wandb(method: TrackedMethod, project: str, out: Path) -> None:
    import wandb

    mode: Any = os.environ.get("WANDB_MODE", "offline")
    settings = wandb.Settings(silent=True, console="off")
    with wandb.init(
        project=project,
        name=method.name,
        config=dict(method.settings),
        dir=out,
        mode=mode,
        settings=settings,
    ) as run:
        frames = sorted({frame for curve in method.curves.values() for frame, _ in curve})
        curves = {metric: dict(curve) for metric, curve in method.curves.items()}
        for frame in frames:
            run.log(
                {
                    f"frame/{metric}": curve[frame]
                    for metric, curve in curves.items()
                    if frame in curve
                },
                step=frame,
            )
        run.summary.update({f"mean/{metric}": value for metric, value in method.means.items()})


WRITERS: Mapping[str, Callable[[TrackedMethod, str, Path], None]] = {
    "tensorboard": _write_tensorboard,
    "mlflow": _write_mlflow,
    "wandb": _write_wandb,
}
