"""The whole road on a small demo capture: prepare, render, score, report; resumed, refused,
extended.
"""

import dataclasses
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError, ProtocolError, RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.run.evaluate import measure, render, reopen
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.prepare import prepare
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.pipelines.run.score import plan_scores, score
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import Frames, Synthesis, Views
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path, read_json
from ggvs_eval.tasks.task import run_batch
from helpers.packed_films import unpack_film
from helpers.refusals import refused
from helpers.whole_run import ALONG_PATH, LABELS, PROTOCOL, capture_of, copy_of


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Capture:
    return open_capture(unpack_film("path", tmp_path_factory.mktemp("capture") / "room"))


@pytest.fixture
def run(whole_run, tmp_path) -> RunFolder:
    """A finished run to change."""
    return copy_of(whole_run, tmp_path / "run")


def copy_truth(run: RunFolder, folder: Path) -> None:
    """Renders that are the captured frames of the test views themselves."""
    for view in run.protocol().views.test:
        shutil.copytree(run.truth(view), folder / view)


def modification_times(root: Path) -> dict[Path, int]:
    files = [*root.rglob("*.png"), *root.rglob("*.npz")]
    return {file: file.stat().st_mtime_ns for file in files}


def measure_again(run: RunFolder, whole_run: Path, labels: Sequence[str] = LABELS) -> Results:
    return measure(plan_run(RunRequest(run.root, capture_of(whole_run), PROTOCOL, labels)), 1)


def test_everything_is_there(whole_run):
    """A run leaves renders of every view and frame, a table of every metric, and a page with
    figures.
    """
    run, summary = RunFolder(whole_run), Results.read(whole_run).summary()

    for label in LABELS:
        for view in PROTOCOL.views.test:
            assert len(list(run.renders(label, view).glob("*.png"))) == PROTOCOL.frames.count
        assert frame_path(run.path(label), 4).is_file()
    assert set(summary.columns) >= set(PROTOCOL.measurement.metrics)
    assert np.isfinite(summary[list(PROTOCOL.measurement.metrics)].to_numpy()).all()
    assert (run.report / "index.html").stat().st_size > 10_000
    assert {file.name for file in (run.report / "figures").iterdir()} > {
        "crops.png",
        "epi.png",
        "curves_TCC.png",
        "x-t_cam01.png",
    }


def test_the_path_is_scored_without_truth_and_beside_it(whole_run):
    """Every method has one value per measure over the whole path; the captured images along it are
    a reference, no method.
    """
    table = Results.read(whole_run).table
    along = table[table["metric"].isin(ALONG_PATH)]
    references = {entry["name"]: entry for entry in read_json(whole_run / "references.json")}

    assert set(along["view"]) == {"path"}
    assert sorted(along.groupby("metric").size()) == [len(LABELS)] * len(ALONG_PATH)
    assert references["Captured images"]["group"] == "path"
    assert references["Captured images"]["values"]["EPI_slope_error"] >= 0
    assert "truth" not in set(table["method"])


def test_ceilings_stand_beside_the_scores(whole_run):
    """A perfect rendering is estimated to score better than any method, and a second recording too;
    both stand in the tables.
    """
    summary = Results.read(whole_run).summary()
    entries = [
        entry
        for entry in read_json(whole_run / "references.json")
        if entry["name"].startswith("Ceiling")
    ]

    assert {entry["group"] for entry in entries} == {"quality", "consistency"}
    for metric in ("PSNR", "TCC"):
        values = [entry["values"].get(metric) for entry in entries]
        ceilings = [value for value in values if isinstance(value, float)]
        assert min(ceilings) > summary[metric].max()
    assert "Ceiling: second recording" in (RunFolder(whole_run).report / "tables.md").read_text(
        encoding="utf-8"
    )


def test_what_no_camera_sees_is_known_before_any_method_renders(whole_run):
    """Masks of every view and frame lie in the run, black and white; what is unseen is a small
    part.
    """
    run = RunFolder(whole_run)
    files = [
        frame_path(run.disoccluded(view), frame)
        for view in PROTOCOL.views.test
        for frame in PROTOCOL.frames.numbers
    ]
    masks = np.array([read_image(file) for file in files])

    assert set(np.unique(masks)) == {0, 255}
    assert masks.mean() < 64


def test_a_second_call_computes_nothing(run, whole_run):
    """Evaluating again leaves every depth map and every frame as it is."""
    before = modification_times(run.root)

    measure_again(run, whole_run)

    assert modification_times(run.root) == before


def test_a_lost_view_is_rendered_again_with_the_same_bits(run, whole_run):
    """Deleting one job's folder brings back exactly that one, bit for bit."""
    folder = run.renders("ours-geometric", "cam01")
    shutil.rmtree(folder)

    assert render(prepare(run.root, capture_of(whole_run), PROTOCOL, labels=LABELS)) == 1
    for frame in PROTOCOL.frames.numbers:
        wanted = read_image(
            frame_path(RunFolder(whole_run).renders("ours-geometric", "cam01"), frame)
        )
        np.testing.assert_array_equal(read_image(frame_path(folder, frame)), wanted)


def test_what_an_earlier_call_left_unfinished_is_named_and_left_out(run, whole_run, capsys):
    """A call for other methods scores them; the one that was stopped comes back when it is asked
    for.
    """
    folder = run.renders("ours-geometric", "cam01")
    frame_path(folder, 2).unlink()

    assert set(measure_again(run, whole_run, LABELS[:1]).table["method"]) == {"no-blending"}
    assert "ours-geometric omitted" in capsys.readouterr().err
    shutil.rmtree(folder)
    assert set(measure_again(run, whole_run).table["method"]) == set(LABELS)


def test_the_target_takes_no_part(whole_run):
    """No depth of any source of a test view was matched against that view."""
    for view, plan in reopen(whole_run, workers=1).plans.items():
        names = {name for job in plan.jobs for name in (job.camera_name, *job.partner_names)}
        assert view not in names
        assert len(plan.jobs) == 3


def test_a_changed_frame_is_scored_again(run):
    """Scores follow the frames on disk, whoever wrote them."""
    before = Results.read(run.root).summary()["PSNR"].droplevel(["dataset", "variant"])
    write_image(frame_path(run.renders("no-blending", "cam00"), 2), np.zeros((48, 64, 3), np.uint8))

    after = score(run).summary()["PSNR"].droplevel(["dataset", "variant"])

    assert after["no-blending"] < before["no-blending"]
    assert after["ours-geometric"] == before["ours-geometric"]


def test_scores_of_methods_that_nobody_asks_for_stay(run):
    """A sweep of one row in a folder of several methods does not cost the others their scores."""
    files = [*run.scores("cam00").glob("*/*/job.json")]
    before = [read_json(file) for file in files]
    tasks = plan_scores(run, [run.labels()[0]], ["cam00"]).view_tasks

    run_batch(tasks)

    assert [read_json(file) for file in files] == before


def test_frames_rendered_elsewhere_are_a_method(run, tmp_path):
    """A folder of <view>/<frame>.png is scored beside the others; the truth itself scores best."""
    copy_truth(run, tmp_path / "mine")

    import_renders(run, "perfect", tmp_path / "mine")
    summary = score(run).summary().droplevel(["dataset", "variant"])

    assert summary.loc["perfect", "SSIM"] == 1.0
    assert summary.loc["perfect", "L1"] == 0.0


def test_gaps_and_wrong_sizes_are_listed(run, tmp_path):
    """Missing frames of foreign renders are an error that names view and frames, a frame of another
    size one with both sizes.
    """
    copy_truth(run, tmp_path / "mine")
    write_image(tmp_path / "large" / "cam00" / "0001.png", np.zeros((60, 80, 3), np.uint8))
    for name in ("cam00/0001.png", "cam01/0001.png", "cam01/0002.png"):
        (tmp_path / "mine" / name).unlink()

    with refused(RenderError, "mine in cam00 lacks 1", "mine in cam01 lacks 1-2"):
        import_renders(run, "mine", tmp_path / "mine")
    shutil.copytree(tmp_path / "large", tmp_path / "mine", dirs_exist_ok=True)
    with refused(RenderError, "mine in cam00", "80 x 60", "64 x 48"):
        import_renders(run, "mine", tmp_path / "mine")


def test_a_folder_belongs_to_one_protocol(run, whole_run):
    """Another protocol in the same folder is refused instead of mixed."""
    with pytest.raises(ProtocolError, match="another protocol"):
        prepare(
            run.root, capture_of(whole_run), dataclasses.replace(PROTOCOL, synthesis=Synthesis(2))
        )


@pytest.mark.slow
def test_the_path_may_show_another_instant_than_the_protocol(room, tmp_path):
    """A true camera path at an instant beyond the protocol's frames has its depth computed and is
    rendered.
    """
    shutil.copytree(room.path, tmp_path / "late")
    note = json.loads((tmp_path / "late" / "demo.json").read_text())
    # frame 3 at 30 fps
    (tmp_path / "late" / "demo.json").write_text(json.dumps(note | {"path_time_s": 0.1}))
    late = open_capture(tmp_path / "late")
    protocol = dataclasses.replace(PROTOCOL, views=Views(("cam00",), "test"), frames=Frames(0, 2))
    prepared = prepare(tmp_path / "run", late, protocol, labels=["no-blending"])

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
def test_what_the_capture_lacks_is_refused(changes, message, room, tmp_path):
    """A protocol that asks for absent views or frames says what there is."""
    with pytest.raises(CaptureError, match=message):
        prepare(tmp_path / "new", room, dataclasses.replace(PROTOCOL, **changes))


def test_a_protocol_is_suggested_by_rule(room):
    """A rig that no packaged protocol was made for gets every second camera, and the protocol says
    so.
    """
    suggested = suggest_protocol(room)

    assert suggested.views.test == ("cam01", "cam03", "cam05")
    assert suggested.views.chosen_by.startswith("by rule")
    assert suggested.frames == Frames(0, 4)
