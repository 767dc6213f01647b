"""Scores are measured again metric by metric: what the code of one has changed, and nothing
else.
"""

from collections.abc import Sequence
from typing import Any

import pytest
import torch

from ggvs_eval import scoring
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.metrics import on_device, stream
from ggvs_eval.pipelines.run import score_view
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.score import plan_scores, score
from ggvs_eval.pipelines.run.score_view import CHECKS
from ggvs_eval.results import installed_versions
from ggvs_eval.run_folder import JOB_FILE, RunFolder, frame_path, read_json, write_json
from ggvs_eval.scoring import MetricScores
from helpers.refusals import refused
from helpers.render_folders import make_run, write_folders

METRICS = ("PSNR", "L1", "TCC", "STED", "STED_ssn", "SDT", "PSNR_static")
MEASURED = ("PSNR", "L1", "TCC", "STED", "STED_ssn", "PSNR_static")  # SDT is made of L1
VIEW = "cam00"


@pytest.fixture
def scored_run(tmp_path) -> RunFolder:
    """A run of two methods that has been scored."""
    made = make_run(tmp_path / "run", METRICS)
    for name in ("one", "other"):
        import_renders(made, name, write_folders(tmp_path / name))
    score(made)
    return made


@pytest.fixture
def measured(monkeypatch) -> list[tuple[str, ...]]:
    """The metrics of every pass over a view from now on."""
    passes: list[tuple[str, ...]] = []
    original = stream.score_views

    def score_views(frames: Any, metrics: Sequence[str], *arguments: Any, **keywords: Any) -> Any:
        passes.append(tuple(metrics))
        return original(frames, metrics, *arguments, **keywords)

    monkeypatch.setattr(stream, "score_views", score_views)
    return passes


def change_code(monkeypatch, *names: str) -> None:
    original = score_view.metric_code
    monkeypatch.setattr(
        score_view,
        "metric_code",
        lambda metric: "changed" if metric.name in names else original(metric),
    )


def records(run: RunFolder) -> dict[str, Any]:
    """Values in no order and reasons of every method in one view."""
    by_label: dict[str, Any] = {}
    for folder in run.scores(VIEW).glob("*/*/"):
        if folder.name != CHECKS:
            scores = MetricScores.read(folder)
            values, reasons = by_label.setdefault(folder.parent.name, ([], {}))
            values += scores.values
            reasons |= scores.not_computed
    return {label: (sorted(values), reasons) for label, (values, reasons) in by_label.items()}


@pytest.mark.parametrize(
    "changed", [("TCC",), ("STED",), ("STED_ssn",), ("PSNR_static", "L1"), MEASURED]
)
def test_the_metrics_whose_code_has_changed(changed, scored_run, measured, monkeypatch):
    """They alone are measured again, of all methods in one pass; together with what stands they are
    what they were.
    """
    before = records(scored_run)
    change_code(monkeypatch, *changed)

    score(scored_run)

    assert [set(metrics) for metrics in measured] == [set(changed)] * 2  # once per view
    assert records(scored_run) == before
    assert all(
        task.is_done() for task in plan_scores(scored_run, scored_run.labels(), [VIEW]).view_tasks
    )


@pytest.mark.parametrize("changed", ["mTV", "mTV2", "Sharpness"])
def test_what_is_measured_beside_a_metric_takes_the_place_of_what_was(
    changed, tmp_path, monkeypatch
):
    """MTV brings its Sharpness along: no value is there twice, whichever of the two is stale, and
    the interval stays.
    """
    made = make_run(tmp_path / "run", ("PSNR", "mTV", "mTV2"))
    import_renders(made, "one", write_folders(tmp_path / "one"))
    before = score(made)
    change_code(monkeypatch, changed)

    after = score(made)

    keys = ["view", "frame", "metric"]
    assert not after.table.duplicated(keys).any()
    assert (
        after.table.sort_values(keys)["value"].tolist()
        == before.table.sort_values(keys)["value"].tolist()
    )


def test_versions_of_all_that_was_made_are_kept(scored_run, monkeypatch):
    """Values that stand keep the versions they were made under; what is measured again by all loses
    the old ones.
    """
    monkeypatch.setattr(scoring, "installed_versions", lambda: {"torch": "0.1"})
    change_code(monkeypatch, "TCC")
    mixed = score(scored_run).provenance["versions"]["torch"]
    assert mixed == f"0.1 and {installed_versions()['torch']}"

    change_code(monkeypatch, *MEASURED)
    monkeypatch.setattr(scoring, "installed_versions", installed_versions)
    monkeypatch.setattr(score_view, "metric_code", lambda metric: "all anew")
    assert score(scored_run).provenance["versions"]["torch"] == installed_versions()["torch"]


def test_another_device_measures_again_what_computes_there(scored_run, measured, monkeypatch):
    """Values are told from those of the CPU, and a device without room is an error of one line that
    leaves them alone.
    """
    before = records(scored_run)

    def run_out(*_: Any) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory")

    with monkeypatch.context() as patch:
        patch.setattr(on_device, "upload", run_out)
        with refused(RenderError, "device cpu:0", "memory", "cpu"):
            score(scored_run, device="cpu:0")
    assert records(scored_run) == before

    measured.clear()
    results = score(scored_run, device="cpu:0")
    # once per view
    assert [set(metrics) for metrics in measured] == [{"TCC", "STED", "STED_ssn"}] * 2
    assert results.provenance["devices"]["metrics"] == "cpu"
    for label, (values, reasons) in records(scored_run).items():
        assert reasons == before[label][1]
        for value, earlier in zip(values, before[label][0], strict=True):
            assert value[:2] == earlier[:2]
            assert value[2] == pytest.approx(earlier[2], rel=1e-4)


def test_values_that_stand_are_those_on_disk(scored_run, monkeypatch):
    """What is not stale is not looked at: a wrong value in the record stays until its own metric
    is.
    """
    file = scored_run.scores(VIEW) / "one" / "L1" / JOB_FILE
    record = read_json(file)
    record["values"][0][2] = 77.5
    write_json(file, record)

    change_code(monkeypatch, "TCC")
    score(scored_run)
    assert 77.5 in [value for *_, value in records(scored_run)["one"][0]]

    change_code(monkeypatch, "TCC", "L1")
    score(scored_run)
    assert 77.5 not in [value for *_, value in records(scored_run)["one"][0]]


def test_changed_frames_make_every_metric_stale(scored_run, measured):
    """Scores of equal frames by equal code stand; another frame of one method is measured by every
    metric, the others by none.
    """
    score(scored_run)
    assert measured == []  # of the same frames by the same code
    file = frame_path(scored_run.renders("one", VIEW), 3)
    write_image(file, 255 - read_image(file))
    before = records(scored_run)

    score(scored_run)

    assert [set(metrics) for metrics in measured] == [set(MEASURED)]
    assert records(scored_run)["other"] == before["other"]
    assert records(scored_run)["one"] != before["one"]
