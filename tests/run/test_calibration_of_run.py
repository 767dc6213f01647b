"""Cameras of a run: refined where source cameras render better, as given where they are precise or
nothing is gained.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.capture import Calibration, Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CommandError
from ggvs_eval.pipelines.commands.evaluate import evaluate
from ggvs_eval.pipelines.run.evaluate import measure, reopen
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import CameraPath, Measurement, Protocol
from ggvs_eval.reports.model.measured import limit_by_cameras, read_scores
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.verdict import evaluate_verdict
from helpers.refusals import refused
from helpers.tasks_left import tasks_left
from helpers.textured_rigs import knocked, see_straight, straight_rig, write_rig

pytestmark = pytest.mark.slow


def written(folder: Path, turn_rad: float) -> Capture:
    """A straight rig whose poses are known with errors, opened."""
    truth, rng = straight_rig(9, 0.4), np.random.default_rng(3)
    known = [knocked(camera, rng, turn_rad, 4 * turn_rad) for camera in truth]
    return open_capture(write_rig(folder, known, [see_straight(camera) for camera in truth]))


def protocol_of(capture: Capture, choice: str | None = "compare") -> Protocol:
    """The suggested protocol, with PSNR alone and no path."""
    protocol = suggest_protocol(capture)
    assert protocol.synthesis.calibration == "compare"
    synthesis = replace(protocol.synthesis, calibration=choice)
    return replace(
        protocol,
        synthesis=synthesis,
        measurement=Measurement(("PSNR",), ceilings=False),
        path=CameraPath(0),
    )


def planned(
    root: Path, capture: Capture, protocol: Protocol, labels: Sequence[str] = ("ours-geometric",)
) -> RunPlan:
    """A run, planned."""
    return plan_run(RunRequest(root, capture, protocol, labels))


def test_knocked_poses_are_refined_where_sources_render_better(tmp_path):
    """The choice is by source cameras, is made once, and what was made with given cameras is
    rendered again.
    """
    capture = written(tmp_path / "rig", 0.005)
    given = measure(planned(tmp_path / "given", capture, protocol_of(capture, "given")), 1)
    compared = measure(planned(tmp_path / "run", capture, protocol_of(capture)), 1)

    run = read_scores(tmp_path / "run")
    assert run.calibration is not None
    assert run.calibration.cameras == "refined"
    assert run.calibration.given_px > 1 > 0.3 > run.calibration.refined_px
    assert run.calibration.psnr_db[1] > run.calibration.psnr_db[0] + 1
    assert "PSNR of source cameras" in run.calibration.describe()
    psnr_db = [float(results.summary()["PSNR"].iloc[0]) for results in (given, compared)]
    assert psnr_db[1] > psnr_db[0] + 1
    import_renders(run.folder, "mine", run.folder.root / "renders" / "ours-geometric")
    assert [read_scores(run.folder.root).name(label) for label in ("mine", "ours-geometric")] == [
        "mine (other cameras)",
        run.names["ours-geometric"],
    ]
    again = reopen(tmp_path / "run", 1, ("ours-geometric",))
    assert tasks_left(again) == []
    poses = [
        [camera.world_to_camera for camera in cameras]
        for cameras in (again.capture.cameras, capture.cameras)
    ]
    assert np.abs(np.subtract(*poses)).max(axis=(1, 2)).min() > 0
    assert {camera.near for camera in again.capture.cameras} == {
        camera.near for camera in capture.cameras
    }


def test_given_poses_that_limit_methods_are_named_first(tmp_path):
    """Headline and caption say so before anything else, with what to do; refined poses have nothing
    to say.
    """
    capture = written(tmp_path / "rig", 0.005)
    results = measure(
        planned(
            tmp_path / "run",
            capture,
            protocol_of(capture, "given"),
            ("no-blending", "distance-based"),
        ),
        1,
    )

    runs = [read_scores(tmp_path / "run")]
    tables = main_tables(runs, results)
    sentence = limit_by_cameras(runs)
    assert (
        "px): refine them in a new run (--calibration compare); the order of methods is decided by "
        "poses." in sentence
    )
    assert tables[0].caption.startswith(sentence)
    assert evaluate_verdict(runs, results, tables).headline.startswith(sentence)


@pytest.mark.usefixtures("no_figures")
def test_poses_that_a_check_calls_bad_stop_who_does_not_refine_them(tmp_path, capsys):
    """The stop names the option, and with it the same folder is evaluated by refined cameras."""
    capture, out = written(tmp_path / "rig", 0.01), tmp_path / "out"
    with refused(CommandError, "stopped: check found faults", "--calibration compare"):
        evaluate(capture.path, out, methods=("no-blending",))
    (out / "protocol.toml").write_text(protocol_of(capture).to_toml())
    evaluate(capture.path, out, methods=("no-blending",), poses="compare")

    assert (
        "check found poses alone at fault, which --calibration compare adjusts"
        in capsys.readouterr().err
    )
    assert read_scores(out / "run").calibration.cameras == "refined"


def test_precise_poses_are_not_compared(tmp_path):
    """What agrees with the pictures is used as given."""
    capture = written(tmp_path / "rig", 0.0)
    plan = planned(tmp_path / "run", capture, protocol_of(capture))
    assert plan.calibration is not None
    plan.calibration(1).run()

    calibration = planned(tmp_path / "run", capture, plan.protocol).original.calibration
    assert isinstance(calibration, Calibration)
    assert (calibration.cameras, calibration.refined_px) == ("given", None)
    assert not calibration.psnr_db
    assert calibration.describe().endswith(
        "px as given: at most 0.5 px, refined ones are not tried"
    )
    assert not calibration.limits_methods
