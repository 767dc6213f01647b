"""What trackers are told: numbers of runs, without their frames."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from ggvs_eval.contrib.export.tracking import MLFLOW_FILE, PACKAGES, track_results, tracked_methods
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.reports.model.measured import read_scores
from ggvs_eval.reports.page.leaderboard import write_leaderboard
from helpers.run_folders import LABELS, RunShape, write_run

SHAPE = RunShape(views=("cam00",), metrics=("PSNR", "LPIPS"), poses=0)


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[Path]:
    """Two scenes under one protocol and one under another, without their frames; nobody changes
    them.
    """
    root = tmp_path_factory.mktemp("runs")
    shapes = {
        "first": replace(SHAPE, scene="first"),
        "second": replace(SHAPE, scene="second", labels=LABELS[:2]),
        "far": replace(SHAPE, scene="first", k=3),
    }
    made = [write_run(root / name, shape) for name, shape in shapes.items()]
    for run in made:
        for folder in ("renders", "truth"):
            shutil.rmtree(run / folder)
    return made


def test_a_tracked_method_has_the_tables_numbers(runs):
    """Means are the summary's, curves have a value per frame, settings name protocol, scene and
    method.
    """
    run = read_scores(runs[0])
    summary = run.results.summary()
    for method, label in zip(tracked_methods(run, "first"), LABELS, strict=True):
        name, _, variant = label.partition("+")
        assert method.means == summary.loc[("Demo room", name, variant)].to_dict()
        assert [frame for frame, _ in method.curves["PSNR"]] == list(run.frames)
        assert method.name == f"first/{label}"
        assert (method.settings["scene"], method.settings["synthesis.k"]) == ("first", "2")
        assert method.settings["protocol_sha256"] == run.protocol.sha256


def test_tensorboard_reads_back_what_was_written(runs, tmp_path):
    """An event file per method holds every mean and every value per frame."""
    pytest.importorskip("tensorboardX")
    out = track_results(runs[:1], "tensorboard", tmp_path / "tracked")
    method = tracked_methods(read_scores(runs[0]), "first")[0]

    scalars = read_scalars(
        next((out / read_scores(runs[0]).protocol.name / method.name).glob("events.*"))
    )
    assert scalars["mean/PSNR", 0] == pytest.approx(method.means["PSNR"])
    assert {
        frame: value for (tag, frame), value in scalars.items() if tag == "frame/LPIPS"
    } == pytest.approx(dict(method.curves["LPIPS"]))


def test_runs_in_folders_of_one_name_are_tracked_apart(runs, tmp_path):
    """Two run folders called alike in different places are two of the tracker's, and two names on
    the leaderboard.
    """
    pytest.importorskip("tensorboardX")
    roots = [
        Path(shutil.copytree(run, tmp_path / place / "run"))
        for run, place in zip(runs[:2], ("a", "b"), strict=True)
    ]
    out = track_results(roots, "tensorboard", tmp_path / "tracked")
    project = out / read_scores(roots[0]).protocol.name
    assert len(list(project.glob("*/run/*"))) == len(LABELS) + 2
    page = write_leaderboard(roots, tmp_path / "board.html").read_text(encoding="utf-8")
    assert "Runs: a/run, b/run." in page


def read_scalars(file: Path) -> dict[tuple[str, int], float]:
    """Scalars of an event file: records of a length, its checksum, the event and its checksum."""
    from tensorboardX.proto.event_pb2 import Event

    content, at, scalars = file.read_bytes(), 0, {}
    while at < len(content):
        length = int.from_bytes(content[at : at + 8], "little")
        event = Event.FromString(content[at + 12 : at + 12 + length])
        scalars |= {
            (value.tag, event.step): value.simple_value
            for value in event.summary.value
            if value.HasField("simple_value")
        }
        at += 16 + length
    return scalars


def test_mlflow_reads_back_what_was_written(runs, tmp_path, monkeypatch):
    """A run per method holds settings, means and curves."""
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    out = track_results(runs[:1], "mlflow", tmp_path / "tracked")
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{out / MLFLOW_FILE}")
    experiment = client.get_experiment_by_name(read_scores(runs[0]).protocol.name)
    found = {run.info.run_name: run for run in client.search_runs([experiment.experiment_id])}
    for method in tracked_methods(read_scores(runs[0]), "first"):
        data = found[method.name].data
        assert data.metrics["mean/PSNR"] == pytest.approx(method.means["PSNR"])
        assert data.params["protocol_sha256"] == method.settings["protocol_sha256"]
        history = client.get_metric_history(found[method.name].info.run_id, "frame/PSNR")
        assert {(point.step, point.value) for point in history} == set(method.curves["PSNR"])


def test_wandb_writes_offline(runs, tmp_path, monkeypatch):
    """A file per method appears, and nothing asks for an account."""
    pytest.importorskip("wandb")
    monkeypatch.delenv("WANDB_MODE", raising=False)
    out = track_results(runs[:1], "wandb", tmp_path / "tracked")
    assert len(list(out.glob("wandb/offline-run-*/run-*.wandb"))) == len(LABELS)


@pytest.mark.parametrize("tracker", PACKAGES)
def test_an_absent_tracker_is_named_in_one_line(runs, tmp_path, tracker, monkeypatch):
    """Without its package the command says which one, and how to get it."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SystemExit) as ended:
        run_command(["report", str(runs[0]), "--to", tracker, "--out", str(tmp_path / "tracked")])
    wanted = f"--to {tracker}: wanted the package {PACKAGES[tracker]}, got none"
    assert str(ended.value.code) == f"ggvs-eval: {wanted}; run pip install 'ggvs-eval[{tracker}]'"
    assert not (tmp_path / "tracked").exists()
