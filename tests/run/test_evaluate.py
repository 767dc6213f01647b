"""The whole road on a small demo capture: prepare, render, score, report; resumed, refused, extended."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError, ProtocolError, RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.methods.registry import METHODS
from ggvs_eval.pipelines.run.evaluate import evaluate, render, reopen
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.prepare import prepare
from ggvs_eval.pipelines.run.score import plan_scores, score
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import Frames, Protocol, Synthesis, Views, load_protocol
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path, read_json
from helpers.refusals import refused

pytestmark = [pytest.mark.usefixtures("no_figures")]

LABELS = ("no-blending", "ours-geometric")
REGIONAL = ("PSNR_static", "PSNR_disoccluded")
ALONG_PATH = ("EPI_coherence", "EPI_slope_error", "reprojection", "switch_ratio")


@pytest.fixture(scope="module")
def demo_capture(tmp_path_factory) -> Capture:
    options = DemoOptions(width=128, height=96, n_frames=4, cameras_per_row=3, path_poses=5, supersampling=1)
    return open_capture(write_demo(tmp_path_factory.mktemp("capture") / "demo", options, workers=1))


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    base = load_protocol("demo")
    metrics = ("PSNR", "SSIM", "L1", "TCC", "STED", "SDT", "SDV", "PSNR_cc", "Flicker", *REGIONAL, *ALONG_PATH)
    return dataclasses.replace(
        base,
        views=Views(("cam00", "cam01"), "test"),
        frames=Frames(0, 4),
        synthesis=Synthesis(3),
        measurement=dataclasses.replace(base.measurement, metrics=metrics),
    )


@pytest.fixture(scope="module")
def finished(demo_capture, protocol, tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("run") / "run"
    evaluate(root, demo_capture, protocol, LABELS, workers=2)
    return root


@pytest.fixture
def finished_copy(finished, tmp_path) -> RunFolder:
    shutil.copytree(finished, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def copy_truth(run: RunFolder, folder: Path) -> None:
    """Renders that are the captured frames of the test views themselves."""
    for view in run.protocol().views.test:
        shutil.copytree(run.truth(view), folder / view)


def modification_times(root: Path) -> dict[Path, int]:
    return {
        file: file.stat().st_mtime_ns
        for file in root.rglob("*")
        if file.suffix in (".png", ".npz") and "report" not in file.parts
    }


def test_everything_is_there(finished, protocol):
    """A run leaves renders of every view and frame, a table of every metric, and a page."""
    run = RunFolder(finished)
    summary = Results.read(finished).summary()

    for label in LABELS:
        assert all(frame_path(run.renders(label, view), t).is_file() for view in protocol.views.test for t in range(4))
        assert frame_path(run.path(label), 4).is_file()
    assert set(summary.columns) >= set(protocol.measurement.metrics)
    assert np.isfinite(summary[list(protocol.measurement.metrics)].to_numpy()).all()
    assert (run.report / "index.html").stat().st_size > 10_000


def test_the_path_is_scored_without_truth_and_beside_it(finished):
    """Every method has one value per measure over the whole path; the captured images along it are a reference, no method."""
    table = Results.read(finished).table
    along = table[table["metric"].isin(ALONG_PATH)]
    references = {entry["name"]: entry for entry in read_json(finished / "references.json")}

    assert set(along["view"]) == {"path"}
    assert sorted(along.groupby("metric").size()) == [len(LABELS)] * len(ALONG_PATH)
    assert references["Captured images"]["group"] == "path"
    assert references["Captured images"]["values"]["EPI_slope_error"] >= 0
    assert "truth" not in set(table["method"])


def test_ceilings_stand_beside_the_scores(finished, protocol):
    """A perfect rendering is estimated to score better than any method, and a second recording too; both stand in the tables."""
    summary = Results.read(finished).summary()
    entries = [entry for entry in read_json(finished / "references.json") if entry["name"].startswith("Ceiling")]
    values = {metric: value for entry in entries for metric, value in entry["values"].items() if isinstance(value, float)}

    assert {entry["group"] for entry in entries} == {"quality", "consistency"}
    assert values["PSNR"] > summary["PSNR"].max()
    assert values["TCC"] > summary["TCC"].max()
    assert "Ceiling: second recording" in (RunFolder(finished).report / "tables.md").read_text(encoding="utf-8")


def test_what_no_camera_sees_is_known_before_any_method_renders(finished, protocol):
    """Masks of every view and frame lie in the run; methods are worse there than where the scene stands still."""
    run, summary = RunFolder(finished), Results.read(finished).summary()
    masks = [read_image(frame_path(run.disoccluded(view), t)) for view in protocol.views.test for t in range(4)]

    assert {int(value) for mask in masks for value in np.unique(mask)} <= {0, 255}
    assert 0 < np.mean([mask.mean() for mask in masks]) < 128
    assert (summary["PSNR_disoccluded"] < summary["PSNR_static"]).all()


def test_a_second_call_computes_nothing(finished_copy, demo_capture, protocol):
    """Evaluating again leaves every depth map and every frame as it is."""
    before = modification_times(finished_copy.root)

    evaluate(finished_copy.root, demo_capture, protocol, LABELS, workers=1)

    assert modification_times(finished_copy.root) == before


def test_a_lost_view_is_rendered_again_with_the_same_bits(finished_copy, demo_capture, protocol):
    """Deleting one job's folder brings back exactly that one, bit for bit, however many workers there are."""
    folder = finished_copy.renders("ours-geometric", "cam01")
    wanted = [read_image(frame_path(folder, t)) for t in range(4)]
    shutil.rmtree(folder)

    done = render(prepare(finished_copy.root, demo_capture, protocol, labels=LABELS))

    assert done == 1
    for t in range(4):
        np.testing.assert_array_equal(read_image(frame_path(folder, t)), wanted[t])


@pytest.mark.slow
def test_what_an_earlier_call_left_unfinished_is_named_and_left_out(finished_copy, demo_capture, protocol, capsys):
    """A call for other methods scores them; the one that was stopped comes back when it is asked for."""
    frame_path(finished_copy.renders("ours-geometric", "cam01"), 2).unlink()
    evaluate(finished_copy.root, demo_capture, protocol, LABELS[:1], workers=1)

    assert "ours-geometric omitted" in capsys.readouterr().err
    assert set(Results.read(finished_copy.root).table["method"]) == {"no-blending"}
    shutil.rmtree(finished_copy.renders("ours-geometric", "cam01"))
    evaluate(finished_copy.root, demo_capture, protocol, LABELS, workers=1)
    assert set(Results.read(finished_copy.root).table["method"]) == {"no-blending", "ours-geometric"}


def test_the_target_takes_no_part(finished):
    """No depth of any source of a test view was matched against that view."""
    prepared = reopen(finished, workers=1)

    for view, plan in prepared.plans.items():
        used = {name for job in plan.jobs for name in (job.camera_name, *job.partner_names)}
        assert view not in used
        assert len(plan.jobs) == 3


def test_a_changed_frame_is_scored_again(finished_copy):
    """Scores follow the frames on disk, whoever wrote them."""
    before = Results.read(finished_copy.root).summary()["PSNR"]
    write_image(frame_path(finished_copy.renders("no-blending", "cam00"), 2), np.zeros((96, 128, 3), np.uint8))

    after = score(finished_copy).summary()["PSNR"]

    assert after.loc[("Demo room", "no-blending", "")] < before.loc[("Demo room", "no-blending", "")]
    assert after.loc[("Demo room", "ours-geometric", "")] == before.loc[("Demo room", "ours-geometric", "")]


def test_scores_of_methods_that_nobody_asks_for_stay(finished_copy):
    """A sweep of one row in a folder of several methods does not cost the others their scores."""
    file = finished_copy.scores("cam00") / "job.json"
    before = read_json(file)["methods"]
    (job,) = plan_scores(finished_copy, [next(iter(before))], ["cam00"]).views

    job.run()

    assert read_json(file)["methods"] == before


def test_frames_rendered_elsewhere_are_a_method(finished_copy, tmp_path):
    """A folder of <view>/<frame>.png is scored beside the others; the truth itself scores best."""
    copy_truth(finished_copy, tmp_path / "mine")

    import_renders(finished_copy, "perfect", tmp_path / "mine")
    summary = score(finished_copy).summary().droplevel("dataset")

    assert summary.loc[("perfect", ""), "SSIM"] == 1.0
    assert summary.loc[("perfect", ""), "L1"] == 0.0


def test_every_gap_is_listed(finished_copy, tmp_path):
    """Missing frames of foreign renders are an error that names view and frames; nothing is skipped."""
    copy_truth(finished_copy, tmp_path / "mine")
    for name in ("cam00/0001.png", "cam01/0002.png", "cam01/0003.png"):
        (tmp_path / "mine" / name).unlink()

    with refused(RenderError, "mine in cam00 lacks 1", "mine in cam01 lacks 2-3"):
        import_renders(finished_copy, "mine", tmp_path / "mine")


def test_a_wrong_size_is_refused(finished_copy, tmp_path):
    """A frame of another size than the truth is named with both sizes."""
    copy_truth(finished_copy, tmp_path / "mine")
    write_image(tmp_path / "mine" / "cam00" / "0001.png", np.zeros((48, 64, 3), np.uint8))

    with refused(RenderError, "mine in cam00", "64 x 48", "128 x 96"):
        import_renders(finished_copy, "mine", tmp_path / "mine")


def test_a_folder_belongs_to_one_protocol(finished_copy, demo_capture, protocol):
    """Another protocol in the same folder is refused instead of mixed."""
    other = dataclasses.replace(protocol, synthesis=Synthesis(2))

    with pytest.raises(ProtocolError, match="another protocol"):
        prepare(finished_copy.root, demo_capture, other)


@pytest.mark.slow
def test_the_path_may_show_another_instant_than_the_protocol(demo_capture, protocol, tmp_path):
    """A true camera path at an instant beyond the protocol's frames has its depth computed and is rendered."""
    shutil.copytree(demo_capture.path, tmp_path / "late")
    note = json.loads((tmp_path / "late" / "demo.json").read_text())
    (tmp_path / "late" / "demo.json").write_text(json.dumps(note | {"path_time_s": 0.1}))  # frame 3 at 30 fps
    late = open_capture(tmp_path / "late")
    prepared = prepare(tmp_path / "run", late, dataclasses.replace(protocol, frames=Frames(0, 2)), labels=["no-blending"])

    render(prepared)

    assert prepared.path_frame == 3
    assert frame_path(prepared.run.path("no-blending"), 4).is_file()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"views": Views(("cam77",), "test")}, r"tests cam77, got cam00, cam01"),
        ({"frames": Frames(2, 9)}, r"wanted frames 2..10, got 4"),
    ],
)
def test_what_the_capture_lacks_is_refused(changes, message, demo_capture, protocol, tmp_path):
    """A protocol that asks for absent views or frames says what there is."""
    with pytest.raises(CaptureError, match=message):
        prepare(tmp_path / "new", demo_capture, dataclasses.replace(protocol, **changes))


def test_a_protocol_is_suggested_by_rule(demo_capture):
    """A rig that no packaged protocol was made for gets every second camera, and the protocol says so."""
    suggested = suggest_protocol(demo_capture)

    assert suggested.views.test == ("cam01", "cam03", "cam05")
    assert suggested.views.chosen_by.startswith("by rule")
    assert suggested.frames == Frames(0, 4)


def test_methods_are_documented():
    """Every method has a title and a line of description, and its label is fit for a folder's name."""
    for label, spec in METHODS.items():
        assert spec.title
        assert spec.describe
        assert label == label.lower().replace(" ", "-")
